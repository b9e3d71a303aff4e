"""Help answers at once: it imports nothing heavy."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest
import typer
from command_line import RunCommand

from climbplan import __version__
from climbplan.cli.app import GROUPS, app

LIGHT = {"climbplan", "typer"}
HEAVY = {
    "numpy", "scipy", "pydantic", "yaml", "h5py", "rich", "matplotlib", "plotly", "casadi", "daqp",
    "clarabel", "osqp", "highspy", "pyscipopt", "cvxpy", "gurobipy", "knitro", "joblib", "asyncio",
    "distributed", "pyarrow", "pymunk", "mujoco",
}  # fmt: skip

PROBE = """
import sys
sys.argv = ["climbplan", *sys.argv[1:]]
from climbplan.cli.app import run
run()
print("MODULES", *sorted({name.partition(".")[0] for name in sys.modules}), file=sys.stderr)
"""


def imported_by_typer() -> set[str]:
    """What typer itself imports (older versions: rich)."""
    code = "import sys, typer; print(*{name.partition('.')[0] for name in sys.modules})"
    probe = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(probe.stdout.split())


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        [],
        ["plan-climb", "--help"],
        ["solve-bookshelf", "--help"],
        ["gen-data", "--help"],
        ["data", "--help"],
        ["fit-stiffness", "--help"],
        ["fit-gripper", "--help"],
        ["fit-terrain", "--help"],
        ["simulate", "--help"],
    ],
)
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    probe = subprocess.run(
        [sys.executable, "-c", PROBE, *arguments], capture_output=True, text=True, check=True
    )
    modules = set(probe.stderr.split("MODULES")[1].split())
    assert modules >= LIGHT
    allowed = imported_by_typer()
    if arguments and arguments[0] in (
        "plan-climb",
        "solve-bookshelf",
        "gen-data",
        "data",
        "fit-stiffness",
        "fit-gripper",
        "fit-terrain",
        "simulate",
    ):
        allowed |= {"pydantic"}  # newer versions of typer read a command's arguments with it
    assert modules & HEAVY <= allowed


def test_every_command_has_help(run_command: RunCommand) -> None:
    listing = run_command("--help")
    assert listing.code == 0
    assert listing.err == ""
    for name in (
        "plan-climb", "solve-bookshelf", "verify", "report", "export", "validate", "schema", "new",
        "doctor", "gen-data", "data",
    ):  # fmt: skip
        assert name in listing.out
        shown = run_command(name, "-h")
        assert shown.code == 0
        assert f"Usage: climbplan {name}" in shown.out


def test_help_shows_every_command_in_one_group(run_command: RunCommand) -> None:
    """Each once, whatever is added; none is left out."""
    shown = run_command("--help").out
    listed = re.findall(r"^  ([a-z][a-z-]+) ", shown, re.M)
    assert len(listed) == len(set(listed))
    assert set(listed) == set(typer.main.get_command(app).commands)
    titles = [line.rstrip(":") for line in re.findall(r"^[A-Z][a-z ]+:$", shown, re.M)]
    assert titles == ["Options", *GROUPS]


def test_version(run_command: RunCommand) -> None:
    shown = run_command("--version")
    assert (shown.code, shown.out) == (0, f"climbplan {__version__}\n")


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["frob"], "No such command"),
        (["plan-climb"], "Missing argument"),
        (["plan-climb", "small.yaml", "--frob"], "No such option"),
        (["plan-climb", "small.yaml", "--jobs", "0"], "--jobs"),
        (["plan-climb", "small.yaml", "--seed", "x"], "--seed"),
        (["solve-bookshelf"], "Missing argument"),
        (["validate"], "Missing argument"),
        (["schema", "frob"], "no spec kind 'frob'"),
        (["new", "frob"], "no spec kind 'frob'"),
    ],
)
def test_bad_usage(run_command: RunCommand, arguments: list[str], fragment: str) -> None:
    outcome = run_command(*arguments)
    assert outcome.code == 2
    assert outcome.out == ""
    assert fragment in outcome.err


def test_shells_complete_commands() -> None:
    """In a process of its own: how `complete` of bash asks."""
    done = subprocess.run(
        [sys.executable, "-m", "climbplan"],
        env={
            **os.environ,
            "_CLIMBPLAN_COMPLETE": "complete_bash",
            "COMP_WORDS": "climbplan plan-t",
            "COMP_CWORD": "1",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["plan-transition"], done.stderr
