"""A robot from a URDF on the command line: template, mistakes, and what is missing."""

from __future__ import annotations

from pathlib import Path

from command_line import RunCommand


def test_template_is_written_and_valid(run_command: RunCommand, workplace: Path) -> None:
    outcome = run_command("new", "robot", "mine", "--example", "robot_walker")
    assert (outcome.code, outcome.out) == (0, "mine/robot_walker.yaml\n")
    assert sorted(p.name for p in (workplace / "mine").iterdir()) == [
        "robot_walker.yaml",
        "walker.urdf",
    ]
    assert run_command("validate", "mine/robot_walker.yaml").out.endswith("ok (robot)\n")


def test_stances_are_tried(run_command: RunCommand, workplace: Path) -> None:
    """What only numbers tell is told by `validate`, with its line."""
    run_command("new", "robot", "--example", "robot_walker")
    path = workplace / "robot_walker.yaml"
    text = path.read_text().replace("[-0.615, 0.33, -0.15]", "[-0.9, 0.33, -0.15]")
    path.write_text(text)
    outcome = run_command("validate", "robot_walker.yaml")
    line = next(n for n, row in enumerate(text.splitlines(), 1) if "-0.9," in row)
    assert outcome.code == 2
    expected = f"robot_walker.yaml:{line}: legs.L1.stance: stance (-0.900, 0.330, -0.150) m cannot"
    assert expected in outcome.err
