"""What surrounds a run: names, streams, variables, disks and directories that fail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import RunCommand

from climbplan.cli.environment import require_sound_environment
from climbplan.errors import UsageError

LONG = "x" * 300
NAMES = {
    "verify": ["verify", LONG],
    "report": ["report", LONG],
    "view": ["view", LONG, "--no-browser"],
    "export": ["export", LONG],
    "simulate": ["simulate", LONG],
    "data": ["data", "info", LONG],
    "new": ["new", "climb", LONG],
    "validate": ["validate", f"{LONG}.yaml"],
    "plan": ["plan-climb", f"{LONG}.yaml"],
    "save": ["plan-climb", "small.yaml", "--save-model", f"{LONG}.mps"],
    "scan": ["fit-terrain", f"{LONG}.png", "-o", "out"],
    "grips": ["fit-gripper", f"{LONG}.csv", "-o", "out"],
    "key": ["validate", "small.yaml", "-s", f"terrain.scan.file={LONG}.stl"],
    "problem": ["solve", "hop.yaml", "--problem", f"{LONG}.py:x"],
}


@pytest.mark.parametrize("name", NAMES)
def test_names_that_are_too_long(name: str, run_command: RunCommand, workplace: Path) -> None:
    (workplace / "hop.yaml").write_text("kind: program\ntheta:\n  - goal: [1.7, 0.1]\n")
    done = run_command(*NAMES[name])
    assert done.code == 2, done.err
    assert "internal error" not in done.err
    assert "File name too long" in done.err or name == "key"


def _run(arguments: str, place: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    program = f"{sys.executable} -m climbplan"
    return subprocess.run(
        ["bash", "-c", arguments.replace("climbplan", program, 1)],
        cwd=place,
        env={**os.environ, "NO_COLOR": "1", **variables},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )


def test_a_reader_of_the_help_that_left(tmp_path: Path) -> None:
    """Exit 141, as of any program that a closed pipe ends."""
    done = _run("climbplan --help | true; echo ${PIPESTATUS[0]}", tmp_path)
    assert (done.stdout.strip(), done.stderr) == ("141", "")


def test_help_on_a_full_disk(tmp_path: Path) -> None:
    done = _run("climbplan --help > /dev/full", tmp_path)
    assert done.returncode == 2
    assert "No space left on device" in done.stderr


def test_encodings_of_few_characters(workplace: Path) -> None:
    name = "d\u00e9 \u2192.yaml"
    (workplace / "small.yaml").rename(workplace / name)
    done = _run(f"climbplan validate '{name}' --json", workplace, PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert name in json.dumps(json.loads(done.stdout), ensure_ascii=False)
    done = _run(f"climbplan validate '{name}'", workplace, PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert "d\\xe9 \\u2192.yaml: ok" in done.stdout


@pytest.mark.parametrize(
    ("name", "value"),
    [("NUMBA_NUM_THREADS", "0"), ("NUMBA_NUM_THREADS", "two"), ("SOURCE_DATE_EPOCH", "abc")],
)
def test_variables_that_libraries_fail_on(name: str, value: str) -> None:
    with pytest.raises(UsageError, match=rf"{name}: expected a whole number of .* got '{value}'"):
        require_sound_environment({name: value})
    require_sound_environment({name: "1"})


def test_figures_need_no_screen_and_no_notebook() -> None:
    assert os.environ["MPLBACKEND"] == "agg"


def test_a_directory_that_was_deleted(workplace: Path) -> None:
    gone = f"mkdir gone; cd gone; rmdir ../gone; climbplan plan-climb {workplace}/small.yaml"
    done = _run(gone, workplace)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "current directory was deleted" in done.stderr


def test_results_inside_a_loop_of_links(run_command: RunCommand, workplace: Path) -> None:
    (workplace / "one").symlink_to("other")
    (workplace / "other").symlink_to("one")
    for target in ("one", "one/x"):
        done = run_command("plan-climb", "small.yaml", "-o", target)
        assert done.code == 2
        assert f"{target}: cannot be written: a link that leads to itself" in done.err
