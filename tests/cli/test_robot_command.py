"""`climbplan robot`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import RunCommand

SPECS = Path(__file__).parents[2] / "specs"


def test_facts_of_a_robot(run_command: RunCommand) -> None:
    told = run_command("robot", "silvia")
    assert told.code == 0
    assert told.out.startswith("SiLVIA: 10.3 kg, 6 limbs, 18 joints\n")
    assert "N a toe, straight up; nearest to its limit is" in told.out
    given = json.loads(run_command("robot", "silvia", "--json", "-o", "silvia.png").out)
    assert given["picture"] == "silvia.png"
    assert Path("silvia.png").read_bytes().startswith(b"\x89PNG")
    assert given["limbs"][0]["name"] == "RF"
    assert given["standing_safety"] > 1
    assert run_command("robot", "silvia", "-o", "silvia.png").code == 2
    assert run_command("robot", "silvia", "-o", "silvia.jpg").code == 2


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (str(SPECS / "climb_steps.yaml"), "SiLVIA: "),
        (str(SPECS / "transition_flat.yaml"), "SiLVIA: "),
        (str(SPECS / "robot_walker.yaml"), "assumed of walker"),
    ],
)
def test_a_robot_file_or_a_spec_that_names_one(
    run_command: RunCommand, name: str, words: str
) -> None:
    if "walker" in name:
        pytest.importorskip("pinocchio")
    done = run_command("robot", name)
    assert (done.code, words in done.out) == (0, True)


def test_what_is_no_robot(run_command: RunCommand) -> None:
    for name, words in (
        ("silva", "built-in robot"),
        (str(SPECS / "limms_throw.yaml"), "names no robot with limbs"),
        ("none.yaml", "none.yaml"),
    ):
        done = run_command("robot", name)
        assert (done.code, done.out) == (2, "")
        assert words in done.err
    Path("bad.yaml").write_text("kind: robot\nname: half\nmass: -1\n")
    done = run_command("robot", "bad.yaml")
    assert done.code == 2
    assert "bad.yaml:3" in done.err
