"""validate, new, schema, doctor, and the commands that read plans."""

from __future__ import annotations

import io
import json
import re
import sys
import types
from importlib import metadata
from pathlib import Path
from typing import TextIO

import pytest
from command_line import RunCommand

from climbplan.cli import dependencies
from climbplan.errors import PlanFileError, UsageError
from climbplan.verification import verification
from climbplan.verification.level import Level


def test_validate(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("new", "robot").out == "silvia.yaml\n"
    good = run_command("validate", "small.yaml", "silvia.yaml")
    assert (good.code, good.err) == (0, "")
    assert good.out == "small.yaml: ok (climb)\nsilvia.yaml: ok (robot)\n"
    mixed = run_command("validate", "small.yaml", "none.yaml", "-s", "task.rounds=3")
    assert mixed.code == 2
    assert mixed.out == "small.yaml: ok (climb)\n"
    assert mixed.err.startswith("none.yaml: no such file")


def test_validate_as_json(run_command: RunCommand) -> None:
    outcome = run_command("validate", "small.yaml", "none.yaml", "--json")
    assert outcome.code == 2
    good, bad = json.loads(outcome.out)["specs"]
    valid = {"spec": "small.yaml", "valid": True, "kind": "climb", "mistakes": []}
    assert good == {**valid, "warnings": []}
    assert bad["valid"] is False
    assert "no such file" in bad["mistakes"][0]["message"]


def test_validate_looks_at_toes_as_the_planner_does(run_command: RunCommand) -> None:
    outcome = run_command("validate", "small.yaml", "-s", "task.goal.toes.RF=[0.6, 0.33, 0]")
    assert outcome.code == 2
    assert "--set task.goal.toes.RF=[0.6, 0.33, 0]: task.goal.toes.RF: expected a" in outcome.err
    assert "15.00 mm off" in outcome.err


def test_standard_input(
    run_command: RunCommand, small_climb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(small_climb.encode())))
    assert run_command("validate", "-").out == "-: ok (climb)\n"


def test_new_writes_specs_that_hold(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("new", "climb").out == "climb_tube.yaml\n"
    assert run_command("new", "robot", "a/b").out == "a/b/silvia.yaml\n"
    assert run_command("validate", "climb_tube.yaml", "a/b/silvia.yaml").code == 0


def test_new_keeps_what_is_there(run_command: RunCommand, workplace: Path) -> None:
    (workplace / "silvia.yaml").write_text("mine")
    refused = run_command("new", "robot")
    assert refused.code == 2
    assert "--force" in refused.err
    assert (workplace / "silvia.yaml").read_text() == "mine"
    assert run_command("new", "robot", "--force").code == 0
    assert "kind: robot" in (workplace / "silvia.yaml").read_text()


def test_new_names_the_option_for_a_robot_file(run_command: RunCommand, workplace: Path) -> None:
    (workplace / "go2.urdf").write_text("<robot/>")
    refused = run_command("new", "robot", "go2.urdf")
    assert refused.code == 2
    assert "got a file; `climbplan new robot --urdf go2.urdf` proposes a robot" in refused.err
    assert run_command("new", "climb", "go2.urdf").err.endswith("got a file\n")


def test_new_refusals(run_command: RunCommand, workplace: Path) -> None:
    for arguments, fragment in (
        (["climb", "small.yaml"], "expected a directory to write into, got a file"),
        (["climb", "/proc/x"], "cannot be created"),
        (["climb", "--example", "silvia"], "no example 'silvia' of kind 'climb'"),
    ):
        outcome = run_command("new", *arguments)
        assert outcome.code == 2
        assert fragment in outcome.err
    assert [entry.name for entry in workplace.iterdir()] == ["small.yaml"]


def test_other_examples(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("new", "climb", "--example", "climb_steps").out == "climb_steps.yaml\n"


def test_schema(run_command: RunCommand) -> None:
    assert json.loads(run_command("schema", "climb").out)["$id"] == "urn:climbplan:spec:climb"
    assert json.loads(run_command("schema", "robot").out)["$id"] == "urn:climbplan:spec:robot"
    kinds = {"climb", "transition", "bookshelf", "envelopes", "program", "dataset"}
    kinds |= {"strategy", "mpc", "limms", "robot", "module"}
    assert set(json.loads(run_command("schema").out)["$defs"]) == kinds


def test_doctor_here(run_command: RunCommand) -> None:
    outcome = run_command("doctor")
    assert outcome.code == 0
    assert "everything required is here" in outcome.out
    report = json.loads(run_command("doctor", "--json").out)
    assert report["ready"] is True
    names = {part["name"] for part in report["parts"]}
    assert names >= {"DAQP", "Clarabel", "OSQP", "HiGHS", "SCIP", "IPOPT", "Gurobi", "Knitro"}
    for part in report["parts"]:
        assert part["usable"] or not part["required"]
        assert part["purpose"]


def test_doctor_misses_what_is_gone(
    run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = (
        dependencies.Dependency("DAQP", "no-such-daqp", "no_such_daqp", "nodes"),
        dependencies.Dependency(
            "Gurobi", "no-such-gurobi", "no_such_gurobi", "nodes", required=False
        ),
        dependencies.Dependency("X", "", "no-such-program", "looks", required=False, install="apt"),
        dependencies.Dependency("IPOPT", "", "numpy/no_such_plugin", "--method nlp"),
    )
    monkeypatch.setattr(dependencies, "PARTS", parts)
    outcome = run_command("doctor")
    assert outcome.code == 2
    assert "DAQP: install with: pip install no-such-daqp" in outcome.out
    assert "missing, optional" in outcome.out
    assert "not ready" in outcome.out
    assert json.loads(run_command("doctor", "--json").out)["ready"] is False
    monkeypatch.setattr(dependencies, "PARTS", parts[1:3])
    assert run_command("doctor").code == 0


def test_doctor_knows_the_wrong_highs(
    run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    def version(package: str) -> str:
        return "1.14.0" if package == "highspy" else metadata.version(package)

    monkeypatch.setattr(dependencies, "version", version)
    outcome = run_command("doctor")
    assert outcome.code == 2
    assert "HiGHS: its presolve gives wrong answers; pip install 'highspy!=1.14.0'" in outcome.out


def test_doctor_covers_every_dependency() -> None:
    covered = {part.package.lower() for part in dependencies.PARTS}
    needed = {
        line.split(";")[0].split(">")[0].split("!")[0].strip().lower()
        for line in metadata.requires("climbplan") or []
        if "extra ==" not in line
    }
    assert needed <= covered


@pytest.mark.parametrize("command", ["verify", "report", "export"])
def test_files_that_are_no_plan(run_command: RunCommand, workplace: Path, command: str) -> None:
    (workplace / "empty").mkdir()
    for path, fragment in (
        ("none.h5", "none.h5: no such file"),
        ("empty", "a directory without plan.h5"),
        ("small.yaml", "small.yaml"),
    ):
        outcome = run_command(command, path)
        assert outcome.code == 2
        assert outcome.out == ""
        assert outcome.err.startswith("error: ")
        assert fragment in outcome.err
    assert sorted(entry.name for entry in workplace.iterdir()) == ["empty", "small.yaml"]


class FakeVerification:
    passed = False
    badge = "not verified"
    risk_summary = ""
    leaves_out: tuple[str, ...] = ("what holds at knots only",)
    fragile: tuple[str, ...] = ("round 1, push: RF: normal force 2.0 of 10.1 N",)
    level = Level.DO_NOT_USE
    advice = "what to do"
    objection = "fails its verification: 1 check, friction fails"
    implausible = ("friction 9 of left",)
    against = None

    def table(self) -> str:
        return "friction  1e-3  FAILED"

    def headline(self) -> str:
        return "1 check, friction fails"

    def require_sound(self, path: Path) -> None:
        """Something can be made of it."""

    def as_dict(self) -> dict[str, bool]:
        return {"passed": self.passed}


def fake_verify(path: Path) -> FakeVerification:
    assert path.name == "plan.h5"
    return FakeVerification()


def fake_report(plan: Path, directory: Path, verification: FakeVerification | None = None) -> None:
    if plan.read_text() == "broken":
        raise PlanFileError(f"{plan}: broken")
    (directory / "report.html").write_text("new page")
    (directory / "figures").mkdir()
    (directory / "figures" / "new.png").write_text("new")


def fake_export(path: Path, out: Path | TextIO) -> None:
    if isinstance(out, Path):
        if out.is_dir():
            raise UsageError(f"{out}: is a directory")
        out.write_text("time,com_x\n")
    else:
        out.write("time,com_x\n")


@pytest.fixture
def plan_directory(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory that looks finished, and stand-ins for what reads it."""
    for module, members in {
        "climbplan.store.plan_format": {"read_plan_format": lambda path: "climbplan/climb"},
        "climbplan.climb.check.verification": {"verify": fake_verify},
        "climbplan.climb.exports.table": {"export_csv": fake_export},
        "climbplan.climb.pages.report": {
            "write_report": fake_report,
            "build_report": lambda plan: {"size": len(plan.name)},
        },
    }.items():
        stand_in = types.ModuleType(module)
        stand_in.__dict__.update(members)
        monkeypatch.setitem(sys.modules, module, stand_in)
    monkeypatch.setattr(verification, "find_stored_differences", lambda path, found: ())
    directory = workplace / "outputs"
    (directory / "figures").mkdir(parents=True)
    (directory / "figures" / "old.png").write_text("old")
    (directory / "plan.h5").write_text("plan")
    (directory / "report.html").write_text("old page")
    return directory


def test_verify(run_command: RunCommand, plan_directory: Path) -> None:
    for argument in ("outputs", "outputs/plan.h5"):
        outcome = run_command("verify", argument)
        lines = [
            "not verified",
            "do not use: what to do",
            "  leaves out: what holds at knots only",
            "  fragile: round 1, push: RF: normal force 2.0 of 10.1 N",
            "friction  1e-3  FAILED",
        ]
        assert (outcome.code, outcome.out.splitlines()) == (5, lines)
        assert outcome.err == "warning: implausible: friction 9 of left\n"
    assert json.loads(run_command("verify", "outputs", "--json").out)["passed"] is False


def test_report_replaces_its_own(run_command: RunCommand, plan_directory: Path) -> None:
    outcome = run_command("report", "outputs")
    assert (outcome.code, outcome.out) == (0, "outputs/report.html\n")
    assert (plan_directory / "report.html").read_text() == "new page"
    assert [path.name for path in (plan_directory / "figures").iterdir()] == ["new.png"]
    names = sorted(path.name for path in plan_directory.iterdir())
    assert names == ["figures", "plan.h5", "report.html"]


def test_report_elsewhere(run_command: RunCommand, plan_directory: Path, workplace: Path) -> None:
    assert run_command("report", "outputs", "-o", "web/page").code == 0
    assert (workplace / "web/page/report.html").exists()
    assert run_command("report", "outputs", "-o", "web/page").code == 2
    assert run_command("report", "outputs", "-o", "web/page", "--force").code == 0
    assert run_command("report", "outputs", "-o", "small.yaml").code == 2


def test_report_that_fails_changes_nothing(run_command: RunCommand, plan_directory: Path) -> None:
    (plan_directory / "plan.h5").write_text("broken")
    assert run_command("report", "outputs").code == 2
    assert (plan_directory / "report.html").read_text() == "old page"
    assert (plan_directory / "figures" / "old.png").exists()
    assert run_command("report", "outputs", "-o", "web").code == 2
    assert not Path("web").exists()


def test_report_as_json_writes_nothing(run_command: RunCommand, plan_directory: Path) -> None:
    told = {"size": 7, "plan": "outputs/plan.h5", "exit_code": 0}
    assert json.loads(run_command("report", "outputs", "--json").out) == told
    assert (plan_directory / "report.html").read_text() == "old page"


def test_export(
    run_command: RunCommand,
    plan_directory: Path,
    workplace: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert run_command("export", "outputs").code == 5  # the stand-in fails its verification
    monkeypatch.setattr(FakeVerification, "passed", True)
    assert run_command("export", "outputs", "--out", "-").out == "time,com_x\n"
    assert run_command("export", "outputs").out == "outputs/trajectory.csv\n"
    assert (plan_directory / "trajectory.csv").read_text() == "time,com_x\n"
    assert run_command("export", "outputs").code == 2
    assert run_command("export", "outputs", "--force").code == 0
    assert run_command("export", "outputs", "-o", "x.csv").out == "x.csv\n"
    for target in ("no/x.csv", "outputs"):
        assert run_command("export", "outputs", "-o", target, "--force").code == 2


def test_export_of_motions(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("plan-climb", "small.yaml", "-o", "run", "--no-report").code == 0
    done = run_command("export", "run", "--format", "npz", "--rate", "50")
    assert (done.code, done.out) == (0, "run/motion.npz\n")
    assert "controllers whose P gains are" in done.err
    assert run_command("export", "run", "--format", "npz").code == 2  # already there
    assert run_command("export", "run", "--gains", "80", "-o", "stiff.csv").out == "stiff.csv\n"
    assert Path("stiff.csv").read_text().startswith("time_s,body_x_m,")
    taken = run_command("export", "run", "--format", "jtc", "--feedforward", "-o", "run")
    assert (taken.code, Path("run/plan.h5").exists()) == (2, True)
    assert run_command("export", "run", "--format", "jtc", "--feedforward").code == 0
    assert run_command("export", "run", "--format", "jtc").code == 2
    assert run_command("export", "run", "--format", "jtc", "--force").code == 0
    assert {file.name for file in Path("run/ros2_control").iterdir()} == {
        "controllers.yaml",
        "export.json",
        "goal.yaml",
    }
    streamed = run_command("export", "run", "--format", "npz", "-o", "-")
    assert (streamed.code, streamed.out) == (2, "")
    wrong = run_command("export", "run", "--rate", "-3", "-o", "x.csv")
    assert "--rate -3: expected more than 0" in wrong.err
    assert not Path("x.csv").exists()


def test_doctor_says_what_each_solver_of_programs_holds(run_command: RunCommand) -> None:
    listed = {s["name"]: s for s in json.loads(run_command("doctor", "--json").out)["solvers"]}
    assert listed["ipopt"]["holds"] == ["balls", "products", "smooth"]
    assert listed["mpcc"]["proves"] is False
    assert "implications" in listed["minlp-scip"]["holds"]
    assert all(solver["purpose"] for solver in listed.values())
    assert re.search(r"^bonmin +present +local +everything", run_command("doctor").out, re.M)
