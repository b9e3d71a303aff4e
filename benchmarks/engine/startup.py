"""Commands of a fresh installation, cold (nothing compiled) and warm, in CPU time of the process.

Both runs start in an empty cache directory, and the second finds there what the first compiled.
Libraries other than Numba, and files that the system keeps in memory, are the same for both: one
run of `climbplan doctor` comes before.
"""

from __future__ import annotations

import os
import resource
import subprocess
import tempfile
from pathlib import Path
from typing import Any, TextIO

from climbplan.errors import UsageError

_SPECS = Path(__file__).parents[2] / "specs"
COMMANDS = {
    "solve, cart-pole": "solve {specs}/cart_pole.yaml --problem {specs}/cart_pole.py:problem",
    "walk": "plan-mpc {specs}/mpc_forward.yaml --no-report",
    "walk of a URDF robot": "plan-mpc {specs}/mpc_telescope.yaml --no-report",
    "books": "solve-bookshelf {specs}/bookshelf_scene.yaml --no-report",
    "modules": "plan-limms {specs}/limms_walk.yaml --no-report",
    "climb": "plan-climb {specs}/climb_obstacle.yaml --no-report",
    "climb, with page": "plan-climb {specs}/climb_obstacle.yaml",
    "climb of a URDF robot": "plan-climb {specs}/climb_walker.yaml --no-report",
}
_QUICK = ("books",)


def run_startup(quick: bool, stream: TextIO, interpreters: list[str]) -> list[dict[str, Any]]:
    """Print a table an interpreter, a line a command; return the CPU seconds of both runs of each.

    Args:
        quick: Whether one command stands for all.
        stream: Stream of the tables.
        interpreters: Those of the environments in which climbplan is installed.

    Raises:
        UsageError: An interpreter does not run climbplan.
    """
    with tempfile.TemporaryDirectory() as directory:
        for python in interpreters:
            _run_command(python, "doctor", Path(directory))
    return [row for python in interpreters for row in _measure_commands(quick, stream, python)]


def _measure_commands(quick: bool, stream: TextIO, python: str) -> list[dict[str, Any]]:
    """Print the table of one interpreter and return its rows."""
    print(f"first run on a machine and second run, CPU time, {python}", file=stream)
    print(f"{'command':<26}{'cold [s]':>12}{'warm [s]':>12}{'difference [s]':>18}", file=stream)
    rows = []
    for name in _QUICK if quick else COMMANDS:
        with tempfile.TemporaryDirectory() as directory:
            place = Path(directory)
            cold, warm = (
                _run_command(python, f"{COMMANDS[name]} -o {place / output}", place)
                for output in ("cold", "warm")
            )
        rows.append({"python": python, "command": name, "cold": cold, "warm": warm})
        print(f"{name:<26}{cold:>12.1f}{warm:>12.1f}{cold - warm:>18.1f}", file=stream)
    print(file=stream)
    return rows


def _run_command(python: str, command: str, caches: Path) -> float:
    """Return the CPU time [s] of a command whose compiled code is stored in `caches`."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    # The environment's own climbplan runs, not one on the path or in the working directory
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    try:
        subprocess.run(
            [python, "-m", "climbplan", *command.format(specs=_SPECS).split()],
            env={**inherited, "NUMBA_CACHE_DIR": str(caches / "numba"), "OMP_NUM_THREADS": "1"},
            cwd=caches,
            capture_output=True,
            text=True,
            check=True,
        )
    except OSError as error:
        raise UsageError(f"--python {python}: {error.strerror}") from None
    except subprocess.CalledProcessError as error:
        message = f"{python} -m climbplan {command} failed:\n{error.stderr}"
        raise UsageError(f"--python: {message}") from None
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
