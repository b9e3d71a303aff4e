"""Ctrl-C ends every solver in seconds, as in a notebook: by itself, nothing kills it.

Most end within half a second. The longest that nothing can interrupt is CasADi compiling the
derivatives of four legs over a jump, up to 2.6 s; a solver that missed its signal runs for minutes.
`tests/cli/test_termination.py` stops commands, which have a process above them that would. Each run
here says when it is inside its solver; how its time is counted stands in `interrupted_runs`.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hard_runs import RUNS
from interrupted_runs import waited_for_core

import climbplan

HERE = Path(__file__).parent
ROOT = Path(climbplan.__file__).parents[1]
LIMIT = 6.0  # [s]
_KILLED = 30.0  # [s] after the signal
SLOW = {"knots", "walk-micp"}  # ten seconds and more until they are inside
MOMENTS = 2


def assert_stops(name: str, after: float, folder: Path) -> None:
    """Press Ctrl-C so many seconds after the run is inside its solver."""
    script = HERE / "hard_runs.py"
    with (folder / "told").open("w+") as told:
        run = subprocess.Popen(
            [sys.executable, str(script), name],
            cwd=folder,
            env={"PYTHONPATH": f"{ROOT}:{HERE}", "PATH": "", "HOME": str(folder)},
            stdout=subprocess.PIPE,
            stderr=told,
            text=True,
            start_new_session=True,  # the test's own Ctrl-C is not its
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        assert run.stdout is not None
        line = run.stdout.readline()
        time.sleep(after)
        before = waited_for_core(run.pid)
        begin = time.monotonic()
        assert run.poll() is None, f"{name} was over before the signal: {line}"
        run.send_signal(signal.SIGINT)
        lost = 0.0
        while run.poll() is None and time.monotonic() < begin + _KILLED:
            lost = max(lost, waited_for_core(run.pid) - before)
            time.sleep(0.01)
        clock = time.monotonic() - begin
        run.kill()
        printed, _ = run.communicate()
        told.seek(0)
        words = told.read()
    assert line == "running\n", words
    assert clock - lost < LIMIT, (name, clock, lost)
    assert run.returncode == -signal.SIGINT, words  # of an interrupt that nobody has caught
    assert words.strip().splitlines()[-1] == "KeyboardInterrupt"
    assert printed == "", "standard output is for results"


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in RUNS],
)
def test_ctrl_c_ends_it(name: str, tmp_path: Path) -> None:
    assert_stops(name, 0.0, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("moment", range(MOMENTS))
@pytest.mark.parametrize("name", RUNS)
def test_ctrl_c_ends_it_later(name: str, moment: int, tmp_path: Path) -> None:
    assert_stops(name, random.Random(f"{name}{moment}").uniform(0.0, 1.0), tmp_path)
