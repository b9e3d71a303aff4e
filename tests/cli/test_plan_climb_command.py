"""`plan-climb` from options to files, streams and exit codes, with a stand-in for the planner."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import types
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from command_line import RunCommand

from climbplan.climb.schema.loading import LoadedClimb
from climbplan.errors import (
    Conflict,
    Infeasible,
    LimitReached,
    ReachFailure,
    Remedy,
    SpecError,
    SpecMistake,
)
from climbplan.verification.level import Level


@dataclass(frozen=True)
class FakePlan:
    summary: tuple[str, ...] = ("small   SiLVIA, 2 rounds", "posture   optimal   0.01 s")
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    status: str = "optimal"


@dataclass(frozen=True)
class FakeVerification:
    passed: bool
    badge: str = "verified"
    model: str = ""
    leaves_out: tuple[str, ...] = ()
    implausible: tuple[str, ...] = ()
    fragile: tuple[str, ...] = ()

    @property
    def level(self) -> Level:
        return Level.DO_NOT_USE if self.objection else Level.FINE

    @property
    def advice(self) -> str:
        return "what to do"

    @property
    def objection(self) -> str:
        if not self.passed:
            return "fails its verification: 14 checks, worst margin: friction"
        return f"must not be used: {self.implausible[0]}" if self.implausible else ""

    def headline(self) -> str:
        return "14 checks, worst margin: friction"


class Stages:
    """What the command calls, to be replaced one by one."""

    def __init__(self) -> None:
        self.loaded: LoadedClimb | None = None
        self.jobs = 0
        self.save_model: Path | None = None
        self.plan: Callable[[], FakePlan] = FakePlan
        self.passed = True

    def plan_climb(
        self,
        loaded: LoadedClimb,
        report: Callable[[str, float], None] | None = None,
        jobs: int = 1,
        save_model: Path | None = None,
        *,
        seek_remedies: bool = True,
    ) -> FakePlan:
        assert report is not None
        assert seek_remedies
        report("posture", 0.0)
        report("posture", 1.0)
        self.loaded, self.jobs, self.save_model = loaded, jobs, save_model
        return self.plan()

    def write_climb(self, plan: FakePlan, path: Path) -> None:
        path.write_text("plan")

    def read_plan_format(self, path: Path) -> str:
        return "climbplan/climb"

    def verify_and_mark(self, path: Path) -> FakeVerification:
        assert path.read_text() == "plan"
        return FakeVerification(self.passed)

    def write_report(
        self, plan_path: Path, directory: Path, verification: FakeVerification
    ) -> None:
        (directory / "report.html").write_text("page")
        (directory / "report.json").write_text('{"status": "optimal"}')


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> Stages:
    """Stand-ins under the names that the command imports."""
    fakes = Stages()
    for module, names in {
        "climbplan.climb.planner.planner": ["plan_climb"],
        "climbplan.climb.plan.file": ["write_climb"],
        "climbplan.store.plan_format": ["read_plan_format"],
        "climbplan.climb.check.verification": ["verify_and_mark"],
        "climbplan.climb.pages.report": ["write_report"],
    }.items():
        stand_in = types.ModuleType(module)
        for name in names:
            stand_in.__dict__[name] = vars(Stages)[name].__get__(fakes)
        monkeypatch.setitem(sys.modules, module, stand_in)
    return fakes


def files(place: Path) -> set[str]:
    return {str(path.relative_to(place)) for path in place.rglob("*") if path.is_file()}


WHOLE = {
    "small.yaml",
    *(f"outputs/small/{name}" for name in ("plan.h5", "report.html", "report.json")),
}


def test_a_verified_plan(run_command: RunCommand, stages: Stages, workplace: Path) -> None:
    outcome = run_command("plan-climb", "small.yaml")
    assert outcome.code == 0
    assert outcome.out == "outputs/small/plan.h5\n"
    head, posture, verify, level = outcome.err.splitlines()
    assert head.startswith("small ")
    assert posture.startswith("posture ")
    assert verify.startswith("verify    passed    0.0")
    assert verify.endswith("s   14 checks, worst margin: friction")
    assert level == "level     fine: what to do"
    assert files(workplace) == WHOLE


def test_what_is_implausible_comes_first_and_what_is_left_out_last(
    run_command: RunCommand, stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = FakeVerification(
        True,
        "verified in its model (linear sag)",
        "linear sag",
        ("the body is held 12 mm off",),
        ("friction 9 of left",),
    )
    module = sys.modules["climbplan.climb.check.verification"]
    monkeypatch.setattr(module, "verify_and_mark", lambda path: found)
    done = run_command("plan-climb", "small.yaml")
    assert done.code == 5
    lines = done.err.splitlines()
    assert lines[0] == "warning: implausible: friction 9 of left"
    assert "s   verified in its model (linear sag); 14 checks" in lines[-4]
    assert lines[-3].split(maxsplit=2) == ["leaves", "out", "the body is held 12 mm off"]
    assert lines[-2] == "level     do not use: what to do"
    refusal = "error: outputs/small/plan.h5 must not be used: friction 9 of left"
    assert lines[-1] == refusal
    quiet = run_command("plan-climb", "small.yaml", "-q", "--force").err
    assert quiet == f"warning: implausible: friction 9 of left\n{refusal}\n"


def test_quiet(run_command: RunCommand, stages: Stages) -> None:
    outcome = run_command("plan-climb", "small.yaml", "-q")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out == "outputs/small/plan.h5\n"


def test_json(run_command: RunCommand, stages: Stages) -> None:
    outcome = run_command("plan-climb", "small.yaml", "--json")
    told = {"status": "optimal", "plan": "outputs/small/plan.h5", "exit_code": 0}
    assert json.loads(outcome.out) == told


def test_options_reach_the_planner(
    run_command: RunCommand, stages: Stages, workplace: Path
) -> None:
    outcome = run_command(
        "plan-climb", "small.yaml", "-o", "there/x", "-s", "task.rounds=5", "--set",
        "terrain.friction=0.8", "--seed", "7", "-j", "2", "--time-limit", "3.5", "--method", "nlp",
        "--solver", "scip", "--solver", "clarabel", "--save-model", "model.txt",
    )  # fmt: skip
    assert outcome.code == 0
    assert outcome.out == "there/x/plan.h5\n"
    assert stages.loaded is not None
    spec = stages.loaded.spec
    assert (spec.task.rounds, spec.terrain.friction, spec.seed) == (5, 0.8, 7)
    assert (spec.solver.time_limit, spec.solver.method) == (3.5, "nlp")
    assert (spec.solver.posture_solver, spec.solver.force_solver) == ("scip", "clarabel")
    assert (stages.jobs, stages.save_model) == (2, Path("model.txt"))


def test_warnings_are_shown_even_when_quiet(run_command: RunCommand, stages: Stages) -> None:
    stages.plan = lambda: FakePlan(warnings=("turns by 17 degrees",))
    assert run_command("plan-climb", "small.yaml", "-q").err == "warning: turns by 17 degrees\n"


@pytest.mark.parametrize("verbose", [True, False])
def test_log_and_python_warnings(run_command: RunCommand, stages: Stages, verbose: bool) -> None:
    def plan() -> FakePlan:
        logging.getLogger("climbplan.climb").warning("%d tries", 3)
        logging.getLogger("climbplan.climb").info("a detail")
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("odd numbers", RuntimeWarning, stacklevel=1)
        return FakePlan(summary=())

    stages.plan = plan
    outcome = run_command("plan-climb", "small.yaml", *(["-v"] if verbose else []))
    details = ["a detail"] if verbose else []
    assert outcome.err.splitlines()[:-2] == ["warning: 3 tries", *details, "warning: odd numbers"]


def test_a_plan_that_fails_verification_is_kept(
    run_command: RunCommand, stages: Stages, workplace: Path
) -> None:
    stages.passed = False
    outcome = run_command("plan-climb", "small.yaml")
    assert outcome.code == 5
    assert "verify    FAILED" in outcome.err
    assert files(workplace) == WHOLE


@pytest.mark.parametrize(
    ("error", "code", "fragment"),
    [
        (
            Infeasible(
                "no forces", [Conflict("round 3", ("friction at RF",), (Remedy("mu >= 0.83"),))]
            ),
            3,
            "round 3: friction at RF cannot be met; feasible with mu >= 0.83",
        ),
        (ReachFailure("LM", "too far", 0.02, "round 2"), 4, "LM cannot reach its toe"),
        (LimitReached("time limit of 1 s"), 4, "time limit of 1 s"),
        (SpecError("x", [SpecMistake("task.rounds", "too few")]), 2, "small.yaml:21: task.rounds"),
        (KeyError("what"), 1, "internal error: KeyError: 'what'"),
        (OSError(28, "No space left on device"), 2, "No space left on device"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_runs_that_end_without_a_plan_leave_nothing(
    run_command: RunCommand,
    stages: Stages,
    workplace: Path,
    error: BaseException,
    code: int,
    fragment: str,
) -> None:
    def fail() -> FakePlan:
        raise error

    stages.plan = fail
    outcome = run_command("plan-climb", str(workplace / "small.yaml"))
    assert outcome.code == code
    assert fragment in outcome.err
    assert outcome.out == ""
    assert "Traceback" not in outcome.err
    assert [entry.name for entry in workplace.iterdir()] == ["small.yaml"]


def test_verbose_shows_the_traceback_of_a_bug(run_command: RunCommand, stages: Stages) -> None:
    def fail() -> FakePlan:
        raise KeyError("what")

    stages.plan = fail
    assert "Traceback" in run_command("plan-climb", "small.yaml", "-v").err


def test_a_finished_directory(run_command: RunCommand, stages: Stages, workplace: Path) -> None:
    assert run_command("plan-climb", "small.yaml").code == 0
    kept = workplace / "outputs/small/kept.txt"
    kept.touch()
    stages.loaded = None
    again = run_command("plan-climb", "small.yaml")
    assert again.code == 2
    assert "--force" in again.err
    assert stages.loaded is None  # refused before any planning
    assert kept.exists()
    assert run_command("plan-climb", "small.yaml", "--force").code == 0
    assert files(workplace) == WHOLE


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["--out", "small.yaml"], "is a file"),
        (["--out", "/proc/x"], "cannot be written"),
        (["--out", "."], "current directory"),
        (["--save-model", "."], "is a directory"),
        (["--save-model", "no/model.txt"], "no such directory"),
        (["--solver", "cplex"], "posture problem: branch-and-bound, scip, gurobi; force problem:"),
        (["--solver", "scipy"], "did you mean 'scip'?"),
        (
            ["--method", "mcip"],
            "--method mcip: solver.method: expected one of `auto`, `micp`",
        ),
        (["--seed", "-1"], "--seed -1: seed: expected a whole number >= 0"),
        (["--time-limit", "nan"], "--time-limit nan: solver.time_limit: expected a number in s"),
        (["--time-limit", "-inf"], "--time-limit -inf: solver.time_limit: expected a number in s"),
        (["--time-limit", "0"], "solver.time_limit: expected a number in s > 0, got 0.0"),
        (["--set", "task.round=3"], "--set task.round=3: task.round: unknown key (did you mean"),
    ],
)
def test_options_are_checked_before_planning(
    run_command: RunCommand,
    stages: Stages,
    workplace: Path,
    arguments: list[str],
    fragment: str,
) -> None:
    outcome = run_command("plan-climb", "small.yaml", *arguments)
    assert outcome.code == 2
    assert fragment in outcome.err
    assert stages.loaded is None
    assert files(workplace) == {"small.yaml"}


def test_a_reader_that_leaves_is_no_error(workplace: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "climbplan", "schema"],
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_standard_output_that_cannot_be_written(workplace: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "climbplan", "schema"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "error: standard output cannot be written: No space left on device\n"
