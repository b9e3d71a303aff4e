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


def run_startup(quick: bool, stream: TextIO, python: str) -> list[dict[str, Any]]:
    """Print a line a command; return the CPU seconds of both runs of each.

    Args:
        quick: Whether one command stands for all.
        stream: Stream of the table.
        python: Interpreter of the environment in which climbplan is installed.

    Raises:
        UsageError: That interpreter does not run climbplan.
    """
    with tempfile.TemporaryDirectory() as directory:
        _run_command(python, "doctor", Path(directory))
    print("first run on a machine and second run, CPU time", file=stream)
    print(f"{'command':<26}{'cold [s]':>12}{'warm [s]':>12}{'difference [s]':>18}", file=stream)
    rows = []
    for name in _QUICK if quick else COMMANDS:
        with tempfile.TemporaryDirectory() as directory:
            place = Path(directory)
            cold, warm = (
                _run_command(python, f"{COMMANDS[name]} -o {place / output}", place)
                for output in ("cold", "warm")
            )
        rows.append({"command": name, "cold": cold, "warm": warm})
        print(f"{name:<26}{cold:>12.1f}{warm:>12.1f}{cold - warm:>18.1f}", file=stream)
    return rows


def _run_command(python: str, command: str, caches: Path) -> float:
    """Return the CPU time [s] of a command whose compiled code is stored in `caches`."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        subprocess.run(
            [python, "-m", "climbplan", *command.format(specs=_SPECS).split()],
            env={**os.environ, "NUMBA_CACHE_DIR": str(caches / "numba"), "OMP_NUM_THREADS": "1"},
            cwd=caches,  # not in the clone: the environment's own climbplan runs
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
