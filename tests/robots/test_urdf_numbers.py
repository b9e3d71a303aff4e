"""What a URDF says is what Pinocchio computes with: numbers, masses, encodings."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
from urdf_walkers import QUADRUPED

from climbplan.errors import SpecError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.model import Robot
from climbplan.robots.urdf import pinocchio_model
from climbplan.robots.urdf.canonical_urdf import write_canonical_urdf
from climbplan.schema.document import Document
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.model import UrdfRobotSpec
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.urdf.tree import read_urdf

SECTION = """kind: robot
urdf: walker.urdf
legs:
  L1: {toe: L1_toe, posture_deg: {L1_lift: 30, L1_knee: 20}}
  R1: {toe: R1_toe, posture_deg: {R1_lift: 30, R1_knee: 20}}
  L2: {toe: L2_toe, posture_deg: {L2_lift: 30, L2_knee: 20}}
  R2: {toe: R2_toe, posture_deg: {R2_lift: 30, R2_knee: 20}}
"""
TEXT = QUADRUPED.text()
HEAD = '<?xml version="1.0"?>\n'


def built(folder: Path, content: bytes) -> Robot:
    (folder / "walker.urdf").write_bytes(content)
    (folder / "robot.yaml").write_text(SECTION)
    return build_robot(load_any_robot("robot.yaml", folder))


def numbers(robot: Robot) -> list[Any]:
    """All that a URDF tells, to be compared exactly."""
    chain = robot.mechanism
    fields = (
        robot.mass, robot.shoulder_body, robot.max_torque, robot.joint_lower, robot.joint_upper,
        robot.max_joint_speed, robot.body_hull, robot.limb_radius, chain.joint_zero,
        chain.axis_zero, chain.toe_zero,
    )  # fmt: skip
    return [np.asarray(field).tolist() for field in fields]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<mass value="4.0"/>', '<mass value=" 4.0 "/>'),
        ('<mass value="4.0"/>', '<mass value="&#9;+.4e1&#10;"/>'),
        ('ixx="0.004"', 'ixx=" 0.004 "'),
        ('xyz="0.2 0.12 0"', 'xyz=" 0.2&#9;0.12&#10;&#13; 0 "'),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0&#9;0&#9;1.0E0 "/>'),
        ('lower="-1.0"', 'lower=" -1.0 "'),
        ('effort="60.0" velocity="5"', 'effort=" 60.0 " velocity=" 5. "'),
        ('size="0.4 0.2 0.08"', 'size="0.4&#9;0.2&#10;0.08 "'),
        ('radius="0.02"', 'radius=" 0.02 "'),
        ('length="0.057"', 'length="&#9;0.057 "'),
    ],
)
def test_white_space_round_numbers(tmp_path: Path, old: str, new: str) -> None:
    assert old in TEXT
    robot = built(tmp_path, TEXT.replace(old, new, 1).encode())
    assert numbers(robot) == numbers(built(tmp_path, TEXT.encode()))


@pytest.mark.parametrize(
    "written",
    ["4_0", "0x4", "\uff14", "\u0664", "4.0\u00a0", "INF", "-INF", "NaN", "inf", "1e400", "4,0",
     "4 kg", "1d1", "", " ", "4 0", "+-4", "e4", ".", "\u22124"],
)  # fmt: skip
def test_what_is_no_number(tmp_path: Path, written: str) -> None:
    """What XML Schema does not take, and what would be infinite, wherever a number can stand."""
    for old, key in (
        ('<mass value="4.0"/>', "`value` of <mass>"),
        ('iyz="0"', "`iyz` of <inertia>"),
        ('upper="1.0"', "`upper` of <limit>"),
        ('effort="60.0"', "`effort` of <limit>"),
        ('radius="0.02"', "`radius` of <cylinder>"),
    ):
        name = key.split("`")[1]
        new = old.replace(old.split(f'{name}="')[1].split('"')[0], written, 1)
        with pytest.raises(SpecError, match=f"{key}: expected a number, got ") as caught:
            built(tmp_path, TEXT.replace(old, new, 1).encode())
        line = TEXT[: TEXT.index(old)].count("\n") + 1
        assert f"robot.yaml:2: urdf: walker.urdf line {line}: " in str(caught.value)
    for old, key in (('xyz="0.2 0.12 0"', "origin"), ('xyz="0 0 1"', "axis")):
        with pytest.raises(SpecError, match=f"`xyz` of <{key}>: expected three numbers"):
            built(tmp_path, TEXT.replace(old, f'xyz="0 0 {written or "x"}1,"', 1).encode())


@pytest.mark.parametrize("name", ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"])
def test_all_moments_of_inertia_are_needed(tmp_path: Path, name: str) -> None:
    start = TEXT.index(f'{name}="')
    without = TEXT[:start] + TEXT[TEXT.index('"', start + 5) + 1 :]
    with pytest.raises(SpecError, match=f"walker.urdf line 4: <inertia> without `{name}`"):
        built(tmp_path, without.encode())


def test_a_mass_that_pinocchio_has_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Should its reader drop a mass all the same, the link is named."""
    whole = write_canonical_urdf

    def lossy(robot: UrdfRobot) -> str:
        return whole(robot).replace('<mass value="4.0">', '<mass value="4.0 ">')

    monkeypatch.setattr(pinocchio_model, "write_canonical_urdf", lossy)
    with pytest.raises(SpecError) as caught:
        built(tmp_path, TEXT.encode())
    said = "robot.yaml:2: urdf: Pinocchio has 0 kg for 'base_link' (walker.urdf line 3), the file 4"
    assert said in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32", "utf-16-be", "utf-32-le"])
@pytest.mark.parametrize(
    "declared",
    [
        "",
        "shift_jis",
        *(pytest.param(d, marks=pytest.mark.slow) for d in ("utf-16", "UTF-8", "idna")),
    ],
)
def test_encodings_with_a_mark_or_wide_characters(
    tmp_path: Path, encoding: str, declared: str
) -> None:
    """The bytes decide, whatever the declaration says."""
    words = f' encoding="{declared}"' if declared else ""
    text = TEXT.replace(HEAD, f'<?xml version="1.0"{words}?>\n')
    text = text.replace('name="walker4"', 'name="l\u00e4ufer"')
    assert built(tmp_path, text.encode(encoding)).name == "l\u00e4ufer"


def test_declared_encodings(tmp_path: Path) -> None:
    for encoding, name in (
        ("iso-8859-1", "l\u00e4ufer"),
        ("Shift_JIS", "\u866b"),
        ("GB18030", "\u866b"),
    ):
        text = TEXT.replace(HEAD, f'<?xml version="1.0" encoding="{encoding}"?>\n')
        text = text.replace('name="walker4"', f'name="{name}"')
        assert built(tmp_path, text.encode(encoding)).name == name
    for unknown in ("idna", "punycode", "unicode_escape", "rot13", "undefined", "x-none"):
        text = TEXT.replace(HEAD, f'<?xml version="1.0" encoding="{unknown}"?>\n')
        with pytest.raises(SpecError, match=f"line 1: declares the encoding {unknown}, expected"):
            built(tmp_path, text.encode())


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (TEXT.encode("utf-16")[:1001], r"walker.urdf line \d+: not UTF-16-LE text"),
        (b"\xff\xfe" + "<robot \ud800/>".encode("utf-16-le", "surrogatepass"), "not UTF-16-LE"),
        (b"<robot>\n\xff</robot>", "walker.urdf line 2: not UTF-8 text"),
        (b"\0\0\0<", "not XML"),
        (b"\xff\xfe", "not XML: no element found"),
        (b"\xff\xfe\0\0<", "not UTF-32-LE text"),
    ],
)
def test_bytes_that_are_no_text(tmp_path: Path, content: bytes, said: str) -> None:
    with pytest.raises(SpecError, match=said):
        built(tmp_path, content)


def test_bounds_of_joints_that_no_leg_has(tmp_path: Path) -> None:
    """Rotors and wheels of simulators turn within +-1e16."""
    rotor = (
        '<joint name="rotor" type="revolute"><parent link="base_link"/><child link="blade"/>'
        '<axis xyz="0 0 1"/><limit lower="-1e16" upper="1e16" effort="1" velocity="1"/></joint>'
        '<link name="blade"/></robot>'
    )
    robot = built(tmp_path, TEXT.replace("</robot>", rotor).encode())
    assert robot.mass == pytest.approx(QUADRUPED.body_mass + 16 * QUADRUPED.link_mass)


def _example_urdfs() -> list[Path]:
    try:
        listed = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return sorted(Path(str(file.locate())) for file in listed if file.suffix == ".urdf")


def test_published_urdfs() -> None:
    """Each is read, and Pinocchio's model of what we hand it is its model of the file."""
    paths = _example_urdfs()
    if not paths:
        pytest.skip("needs the URDFs of `pip install --no-deps example-robot-data`")
    compared = 0
    for path in paths:
        if path.name == "ur3.urdf":  # has no link
            continue
        tree = read_urdf(path)
        spec = UrdfRobotSpec.model_construct(urdf=str(path))
        robot = UrdfRobot(spec, tree, "", {}, {}, Document(str(path), "", None), ())
        root = pinocchio.JointModelFreeFlyer()
        own = pinocchio.buildModelFromXML(write_canonical_urdf(robot), root)
        published = pinocchio.buildModelFromUrdf(str(path), root)
        assert list(own.names) == list(published.names)
        for index in range(own.njoints):
            assert own.jointPlacements[index] == published.jointPlacements[index]
            assert own.inertias[index] == published.inertias[index]
        assert not list(pinocchio_model.find_mass_mismatches(robot, own, pinocchio))
        compared += 1
    assert compared >= len(paths) - 1
