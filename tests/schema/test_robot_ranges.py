"""Numbers that no robot has are mistakes of the spec, named where they stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.errors import SpecError
from climbplan.schema.robots.source import load_any_robot, read_robot_text

SPECS = Path(__file__).parents[2] / "specs"
SILVIA = read_robot_text("silvia")
WALKER = (SPECS / "robot_walker.yaml").read_text()
URDF = (SPECS / "walker.urdf").read_text()


def refusal(folder: Path, text: str, urdf: str = URDF) -> str:
    (folder / "robot.yaml").write_text(text)
    (folder / "walker.urdf").write_text(urdf)
    with pytest.raises(SpecError) as caught:
        load_any_robot("robot.yaml", folder)
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass: 10.3", "mass: 1e-300", "mass: expected from 0.001 to 1e+06 kg, got 1e-300"),
        (
            "[45, 45, 45]",
            "[45, 1e-300, 45]",
            "joint_stiffness: expected from 0.01 to",
        ),
        ("[0.057, 0.195, 0.375]", "[0.057, 1e8, 0.375]", "link_lengths: expected from 0.0001 to"),
        ("[25, 25, 25]", "[25, 25, 1e-9]", "max_torque: expected from 0.0001 to 1e+07 N m, got"),
    ],
)
def test_a_robot_file(old: str, new: str, words: str, tmp_path: Path) -> None:
    assert old in SILVIA
    assert words in refusal(tmp_path, SILVIA.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "joint_stiffness: 150 ",
            "joint_stiffness: 1e-300 ",
            "joint_stiffness: expected from",
        ),
        (
            "joints: {}",
            "joints: {L1_yaw: {stiffness: 1e-300}}",
            "joints.L1_yaw.stiffness: ",
        ),
        ("joints: {}", "limb_radius: 1e9", "limb_radius: expected from 0 to 100 m, got 1e+09"),
        (
            "joints: {}",
            "workspace: {reach: 1e-9}",
            "workspace.reach: expected from",
        ),
        ("joints: {}", "gravity: 1e8", "gravity: expected from 0 to 1000 m/s^2, got 1e+08"),
    ],
)
def test_a_section_that_names_a_urdf(old: str, new: str, words: str, tmp_path: Path) -> None:
    assert old in WALKER
    assert words in refusal(tmp_path, WALKER.replace(old, new, 1))


def with_attribute(tag: str, attribute: str, value: str) -> str:
    """The URDF with an attribute of the first element `tag` changed."""
    at = URDF.index(f"<{tag}")
    start = URDF.index(f'{attribute}="', at) + len(attribute) + 2
    return URDF[:start] + value + URDF[URDF.index('"', start) :]


@pytest.mark.parametrize(
    ("tag", "attribute", "value", "words"),
    [
        ("box", "size", "1e9 0.1 0.1", "<box>: expected `size` up to 100 m, got 1e+09"),
        ("cylinder", "radius", "1e9", "<cylinder>: expected `radius` up to 100 m, got 1e+09"),
        (
            "origin",
            "xyz",
            "0 1e9 0",
            "`xyz` of <origin>: expected from -100 to 100 m, got 0",
        ),
        ("mass", "value", "1e300", "<mass>: expected 1e+06 kg at most, got 1e+300"),
        ("limit", "upper", "1e16", 'a joint without bounds has type="continuous"'),
        ("limit", "effort", "1e-300", "no torque limit: expected `effort` > 0"),
    ],
)
def test_a_urdf(tag: str, attribute: str, value: str, words: str, tmp_path: Path) -> None:
    if f"<{tag}" not in URDF:
        pytest.skip(f"the shipped URDF has no <{tag}>")
    assert words in refusal(tmp_path, WALKER, with_attribute(tag, attribute, value))
