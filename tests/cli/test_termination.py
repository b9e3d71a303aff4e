"""Every method that can run for long ends within two seconds of Ctrl-C or SIGTERM.

`python -m pytest -m slow tests/cli/test_termination.py` stops each of them at two moments; a few
are stopped in the everyday run. How the time is counted stands in `interrupted_runs`.
"""

from __future__ import annotations

import random
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from interrupted_runs import stop_run
from solver_runs import RUNS, SPECS, SolverRun

import climbplan

ROOT = Path(climbplan.__file__).parents[1]
LIMIT = 2.0  # [s]
MOMENTS = 2
# One of each way in which solvers are called: through CasADi, HiGHS's callbacks, a thread (SCIP), a
# process of its own (Bonmin), worker processes
EVERYDAY = {
    "climb-micp": signal.SIGTERM,
    "modules-admm": signal.SIGINT,
    "pole-scip": signal.SIGTERM,
    "pole-bonmin": signal.SIGINT,
    "data-pole": signal.SIGINT,
}


@pytest.fixture(scope="session")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What some commands begin from: solved scenes and a plan."""
    folder = tmp_path_factory.mktemp("given")
    for words in (
        f"gen-data {SPECS}/dataset_bookshelf.yaml -o data",
        f"plan-climb {SPECS}/climb_steps.yaml -o steps",
    ):
        command = [sys.executable, "-m", "climbplan", *words.split()]
        subprocess.run(command, cwd=folder, capture_output=True, check=True)
    return folder


_ATTEMPTS, _EARLIER = 6, 0.6  # machines differ in the work that a run is


def assert_stops(
    run: SolverRun, given: Path, folder: Path, after: float, number: signal.Signals
) -> None:
    for attempt in range(_ATTEMPTS):
        here = folder / f"attempt{attempt}"
        here.mkdir()
        ending = stop_run(run.arguments(given), here, after, number, ROOT)
        at = f"{run.name}, {number.name} after {after:.2f} s of work: {ending}"
        # Through already, or its files were in their place: the moment says nothing of solvers
        if not ending.early and "out" not in ending.left:
            break
        assert "out" not in ending.left or any((here / "out").iterdir()), at
        after *= _EARLIER
    assert not ending.early, at
    assert ending.code == {signal.SIGINT: 130, signal.SIGTERM: 143}[number], at
    assert ending.seconds < LIMIT, at
    # The rows that a run has made are kept, and `--resume` goes on with them
    kept = {".out.rows"} if run.words[0] == "gen-data" else set()
    assert set(ending.left) <= kept, at
    assert not ending.survivors, at
    word = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}[number]
    assert ending.told.splitlines()[-1] == word, at
    assert ending.told.count(word) == 1, at
    assert "Traceback" not in ending.told, at


@pytest.mark.parametrize("name", EVERYDAY)
def test_a_run_ends_and_leaves_nothing(tmp_path: Path, name: str) -> None:
    (run,) = (run for run in RUNS if run.name == name)
    assert_stops(run, tmp_path, tmp_path, 0.5 * run.work, EVERYDAY[name])


@pytest.mark.slow
@pytest.mark.parametrize("moment", range(MOMENTS))
@pytest.mark.parametrize("run", RUNS, ids=lambda run: run.name)
def test_every_method_ends(tmp_path: Path, given: Path, run: SolverRun, moment: int) -> None:
    after = random.Random(f"{run.name}{moment}").uniform(0.05, 1.0) * run.work
    assert_stops(run, given, tmp_path, after, (signal.SIGINT, signal.SIGTERM)[moment % 2])


def test_solvers_that_block_are_called_in_one_place_each() -> None:
    """Elsewhere nothing would stop them."""
    calls = {
        r"nlpsol\(": {"solvers/ipopt/program.py", "solvers/bonmin.py"},  # Bonmin: its own process
        # Linear programs of 20 variables beside the one place
        r"solver\.run\(\)": {
            "solvers/highs/model.py",
            "robots/urdf/proposal/lift_torque.py",
        },
        r"model\.optimize": {"solvers/scip/run.py", "solvers/gurobi.py"},
        r"solve\(raise_error": {"solvers/convex/osqp.py"},
    }
    package = ROOT / "climbplan"
    for pattern, places in calls.items():
        found = {
            str(path.relative_to(package))
            for path in package.rglob("*.py")
            if re.search(pattern, path.read_text())
        }
        assert found == places, pattern
