"""Every mistake in a robot section that names a URDF: its line, its key, and what was expected."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from urdf_walkers import QUADRUPED, Walker

from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.schema.loading import load_spec
from climbplan.schema.robots.source import load_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot

CLIMB = """kind: climb
robot:
  urdf: walker.urdf
  joint_stiffness: 150
  legs:
    L1: {toe: L1_toe, posture_deg: {L1_lift: 30, L1_knee: 20}}
    R1: {toe: R1_toe, posture_deg: {R1_lift: 30, R1_knee: 20}}
    L2: {toe: L2_toe, posture_deg: {L2_lift: 30, L2_knee: 20}}
    R2: {toe: R2_toe, posture_deg: {R2_lift: 30, R2_knee: 20}}
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.2]}
task:
  rounds: 1
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.1]}
"""


def mistakes(folder: Path, climb: str = CLIMB, urdf: str | None = None) -> list[str]:
    """What is wrong with a climb and its URDF, as the command line says it."""
    text = QUADRUPED.text() if urdf is None else urdf
    (folder / "walker.urdf").write_text(text, encoding="latin-1")
    spec = folder / "s.yaml"
    spec.write_text(climb)
    with pytest.raises(SpecError) as caught:
        load_climb(spec)
    return [line.removeprefix(f"{folder}/") for line in str(caught.value).splitlines()]


def changed(text: str, *pairs: tuple[str, str]) -> str:
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_a_sound_section_loads(tmp_path: Path) -> None:
    QUADRUPED.write(tmp_path / "walker.urdf")
    (tmp_path / "s.yaml").write_text(CLIMB)
    loaded = load_climb(tmp_path / "s.yaml")
    assert isinstance(loaded.robot, UrdfRobot)
    assert loaded.robot.name == "walker4"
    assert loaded.robot.limb_names == ("L1", "R1", "L2", "R2")
    names = [joint.name for joint in loaded.robot.joints["L1"]]
    assert names == ["L1_yaw", "L1_lift", "L1_knee", "L1_ankle"]
    # Without leaving the section in the spec: a robot file
    section = CLIMB[CLIMB.index("  urdf") : CLIMB.index("terrain")].replace("\n  ", "\n")
    (tmp_path / "robot.yaml").write_text(f"kind: robot\n{section.strip()}\n")
    assert isinstance(load_spec(tmp_path / "robot.yaml"), UrdfRobot)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("walker.urdf", "wlaker.urdf", "s.yaml:3: robot.urdf: no such file: "),
        ("joint_stiffness", "joint_stifness", "(did you mean 'joint_stiffness'?)"),
        ("toe: L1_toe,", "toe: L1_tow,", "s.yaml:6: robot.legs.L1.toe: the URDF has no link"),
        ("toe: L1_toe,", "toe: L1_tow,", "(did you mean 'L1_toe'?)"),
        ("toe: L1_toe,", "toe: L1_lift_link,", "expected 3 to 7 joints that move from 'base_link'"),
        ("toe: L1_toe,", "toe: L1_lift_link,", "with two a toe moves on a surface alone"),
        ("toe: L2_toe,", "toe: L1_toe,", "moves L1 and L2 together; expected joints of its own"),
        ("L1_lift: 30", "L1_lfit: 30", "leg L1 has no joint 'L1_lfit', only L1_yaw, L1_lift"),
        ("L1_lift: 30", "L1_lift: 300", "expected an angle within the joint's bounds, -85.94 to"),
        ("joint_stiffness: 150", "base: trunk", "s.yaml:4: robot.base: the URDF has no link"),
        ("joint_stiffness: 150", "joints: {hip: {max_torque: 3}}", "the URDF has no joint 'hip'"),
        (
            "joint_stiffness: 150",
            "joints: {L1_yaw: {max_torque: -3}}",
            "expected a number in N m or N > 0",
        ),
        (
            "joint_stiffness: 150",
            "forward: w",
            "expected one of `x`, `-x`, `y`, `-y`, `z`, `-z`, got 'w'",
        ),
        (
            "joint_stiffness: 150",
            "up: -x",
            "expected an axis square to `forward: x`, got '-x'",
        ),
        ("legs:", "leggs:", "unknown key (did you mean 'legs'?)"),
        (
            "rounds: 1",
            "rounds: 1\n  gait: [L1, R1, L2]",
            "expected each limb once (L1, R1, L2, R2)",
        ),
    ],
)
def test_mistakes_of_the_section(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert any(expected in line for line in mistakes(tmp_path, changed(CLIMB, (old, new))))


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('effort="60.0"', 'effort="0"', "no torque limit: expected `effort` > 0 in its <limit>"),
        ('effort="60.0" ', "", "or `joints: {L1_yaw: {max_torque: NUMBER}}` [N m] here"),
        ('velocity="5"', 'velocity="-1"', "no speed limit: expected `velocity` > 0"),
        ('lower="-1.0"', 'lower="2.0"', "expected <limit> with lower < upper, got 2 and 1 rad"),
        ('type="revolute"', 'type="planar"', "a planar joint; expected revolute, continuous"),
        (
            'velocity="5"/>',
            'velocity="5"/><mimic joint="R1_yaw"/>',
            "mimics 'R1_yaw', a joint of R1",
        ),
    ],
)
def test_joints_no_leg_can_have(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = changed(QUADRUPED.text(), (old, new))
    (found,) = mistakes(tmp_path, urdf=text)
    line = line_of(text, 'name="L1_yaw"')
    where = f"joint 'L1_yaw' (walker.urdf line {line})"
    assert found.startswith(f"s.yaml:6: robot.legs.L1.toe: {where}: ")
    assert expected in found


def test_limits_may_be_given_in_the_section(tmp_path: Path) -> None:
    text = changed(QUADRUPED.text(), ('effort="60.0" velocity="5"', ""))
    (tmp_path / "walker.urdf").write_text(text)
    own = "joints: {L1_yaw: {max_torque: 9, max_speed: 2}}"
    (tmp_path / "s.yaml").write_text(changed(CLIMB, ("joint_stiffness: 150", own)))
    assert isinstance(load_climb(tmp_path / "s.yaml").robot, UrdfRobot)


def test_closed_chains(tmp_path: Path) -> None:
    bar = (
        '<joint name="bar" type="revolute"><parent link="R1_knee_link"/>'
        '<child link="L1_knee_link"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    text = changed(QUADRUPED.text(), ("</robot>", f"{bar}\n</robot>"))
    (found,) = mistakes(tmp_path, urdf=text)
    assert "robot.urdf: closed chain: link 'L1_knee_link' is the child of joints 'L1_knee'" in found
    assert "and 'bar'" in found


@pytest.mark.parametrize("parent", ["L1_yaw_link", "L1_toe"])
def test_rings_without_a_root(tmp_path: Path, parent: str) -> None:
    ring = ('<parent link="base_link"/><child link="L1_yaw_link"/>', "base_link", parent)
    text = changed(QUADRUPED.text(), (ring[0], ring[0].replace(*ring[1:])))
    (found,) = mistakes(tmp_path, urdf=text)
    assert "closed chain: link 'L1_yaw_link' is carried by itself" in found


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('xyz="0.2 0.12 0"', 'xyz="nan 0.12 0"', "`xyz` of <origin>: expected three numbers"),
        ('xyz="0.2 0.12 0"', 'xyz="0.2 0.12"', "`xyz` of <origin>: expected three numbers"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "expected an axis of some length"),
        ('<mass value="4.0"/>', "", "<inertial> without <mass value=...> or <inertia>"),
        (
            '<box size="0.4 0.2 0.08"/>',
            "<torus/>",
            "one shape expected, box, cylinder, capsule, sphere",
        ),
        ('<box size="0.4 0.2 0.08"/>', '<box size="0.4 0 0.1"/>', "<box>: expected `size` > 0"),
    ],
)
def test_what_pinocchio_would_leave_out(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = changed(QUADRUPED.text(), (old, new))
    (found,) = mistakes(tmp_path, urdf=text)
    line = next(n for n, row in enumerate(text.splitlines(), 1) if (new and new in row) or not new)
    assert expected in found
    assert not new or f"s.yaml:3: robot.urdf: walker.urdf line {line}: " in found


def test_all_that_is_wrong_in_a_urdf(tmp_path: Path) -> None:
    text = changed(
        QUADRUPED.text(), ('<mass value="4.0"/>', ""), ('xyz="0.2 0.12 0"', 'xyz="a b c"')
    )
    assert len(mistakes(tmp_path, urdf=text)) == 2


def test_weights_and_connections(tmp_path: Path) -> None:
    weightless = replace(QUADRUPED, body_mass=0.0, link_mass=0.0).text()
    (found,) = mistakes(tmp_path, urdf=weightless)
    assert "s.yaml:3: robot.urdf: zero mass: no link of the URDF has any" in found
    given = changed(CLIMB, ("joint_stiffness: 150", "mass: 7.0"))  # it would stand nowhere
    assert "`mass` alone does not tell where it acts" in mistakes(tmp_path, given, weightless)[0]
    negative = changed(QUADRUPED.text(), ('<mass value="4.0"/>', '<mass value="-4"/>'))
    assert "link 'base_link' has the mass -4 kg" in mistakes(tmp_path, urdf=negative)[0]
    loose = changed(QUADRUPED.text(), ("</robot>", '<link name="stone"/></robot>'))
    expected = "expected one root link, got base_link, stone unconnected"
    assert expected in mistakes(tmp_path, urdf=loose)[0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<robot name='x'>", "walker.urdf line 1: not XML: no element found"),
        ("{}", "not XML: not well-formed (invalid token)"),
        ("", "not XML: no element found"),
        ("<sdf/>", "an SDF file, which Pinocchio reads only where it is built with sdformat"),
        ("<robot name='x'/>", "no <link> in it"),
        ("<robot><xacro:arm/></robot>", "line 1: <xacro:arm> is left for xacro to expand"),
        (
            "<robot xmlns:x='http://ros.org/wiki/xacro'>\n<link name='a'><x:if/></link></robot>",
            "line 2: <x:if> is left for xacro to expand",
        ),
        ("<robot>\n<link name='${side}_a'/></robot>", "line 2: '${side}_a' is left for xacro"),
        ("<robot name='$(arg name)'><link name='a'/></robot>", "'$(arg name)' is left for xacro"),
        (
            "<!DOCTYPE r [<!ENTITY a 'aa'><!ENTITY b '&a;&a;'>]><robot name='&b;'/>",
            "declares XML entities, which a URDF has no need of",
        ),
        ("<robot><link/></robot>", "<link> without `name`"),
        ("<robot><link name='a'/><link name='a'/></robot>", "two links are named 'a'"),
        (
            "<robot><link name='a'/><joint name='j' type='x'><parent link='a'/></joint></robot>",
            "joint 'j' has no <child>",
        ),
        (
            (
                "<robot><link name='a'/><joint name='j' type='y'><parent link='a'/>"
                "<child link='a'/></joint></robot>"
            ),
            "joint 'j' has the type 'y', expected revolute, continuous, prismatic,",
        ),
        (
            "<robot><link name='a'><inertial><mass value='much'/></inertial></link></robot>",
            "`value` of <mass>: expected a number, got 'much'",
        ),
        ("<a>" * 500, "elements nested more than 200 deep"),
        ("\xff<robot/>", "not UTF-8 text"),
    ],
)
def test_texts_that_are_no_urdf(tmp_path: Path, text: str, expected: str) -> None:
    (found,) = mistakes(tmp_path, urdf=text)
    assert found.startswith("s.yaml:3: robot.urdf: ")
    assert expected in found


def test_what_xacro_leaves_behind_is_a_urdf(tmp_path: Path) -> None:
    """Its namespace on the root, and a `$(...)` for other programs."""
    text = changed(
        QUADRUPED.text(),
        ("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '),
        ("</robot>", '<gazebo><plugin file="$(find pkg)/a"/></gazebo></robot>'),
    )
    for name in ("walker.urdf", "walker.urdf.xacro"):
        (tmp_path / name).write_text(text)
        (tmp_path / "s.yaml").write_text(CLIMB.replace("walker.urdf", name))
        assert load_climb(tmp_path / "s.yaml").robot.name == "walker4"


@pytest.mark.parametrize(
    ("name", "there", "made"),
    [
        ("walker.urdf", [], "walker_expanded.urdf"),
        ("walker.xacro", [], "walker.urdf"),
        ("walker.urdf.xacro", [], "walker.urdf"),
        ("walker.urdf.xacro", ["walker.urdf"], "walker_expanded.urdf"),
        ("a walker.xacro", [], "'a walker.urdf'"),
        ("walker", ["walker.urdf", "walker_expanded.urdf"], "walker_expanded_2.urdf"),
    ],
)
def test_the_advice_on_xacro_empties_no_file(
    tmp_path: Path, name: str, there: list[str], made: str
) -> None:
    """The shell opens what stands behind `>` before xacro reads anything."""
    for other in there:
        (tmp_path / other).write_text("<robot/>")
    (tmp_path / name).write_text(QUADRUPED.text().replace("</robot>", "<xacro:arm/></robot>"))
    (tmp_path / "s.yaml").write_text(CLIMB.replace("walker.urdf", name))
    with pytest.raises(SpecError) as caught:
        load_climb(tmp_path / "s.yaml")
    command = str(caught.value).partition("make the URDF with `")[2].rpartition("`")[0]
    program, source, arrow, target = shlex.split(command)
    assert (program, arrow) == ("xacro", ">")
    assert source == str(tmp_path / name)
    assert target == str(tmp_path / shlex.split(made)[0])
    assert not Path(target).exists()


def test_all_mistakes_come_together(tmp_path: Path) -> None:
    climb = changed(
        CLIMB,
        ("toe: L1_toe,", "toe: foot,"),
        ("R2_knee: 20", "R2_knee: 200"),
        ("friction: 1.0", "friction: -1.0"),
    )
    urdf = changed(QUADRUPED.text(), ('effort="60.0"', 'effort="0"'))
    assert len(mistakes(tmp_path, climb, urdf)) == 3  # L1's joint is not looked at without its toe


def test_packages_and_meshes_not_found(tmp_path: Path) -> None:
    walker = Walker(mesh="package://walker_description/body.stl")
    (found,) = mistakes(tmp_path, urdf=walker.text())
    assert "robot.packages: walker.urdf line 5: package 'walker_description' not found" in found
    assert "expected `packages: {walker_description: DIRECTORY}`" in found
    own = "packages: {walker_description: nowhere}"
    climb = changed(CLIMB, ("joint_stiffness: 150", own))
    assert (
        "package 'walker_description': no directory" in mistakes(tmp_path, climb, walker.text())[0]
    )
    (found,) = mistakes(tmp_path, urdf=replace(walker, mesh="meshes/body.stl").text())
    assert "mesh 'meshes/body.stl' not found: no file" in found
    (found,) = mistakes(tmp_path, urdf=replace(walker, mesh="http://x.org/a.stl").text())
    assert "expected package://, file:// or a path" in found


def test_a_urdf_alone_is_no_robot(tmp_path: Path) -> None:
    climb = f"{CLIMB[: CLIMB.index('robot:')]}robot: walker.urdf\n{CLIMB[CLIMB.index('terrain') :]}"
    (found,) = mistakes(tmp_path, climb)
    assert "s.yaml:2: robot: expected a built-in robot" in found
    assert "`robot: {urdf: PATH, legs: {NAME: {toe: LINK}}}`" in found


def test_commands_for_coxa_femur_and_tibia_say_so(tmp_path: Path) -> None:
    QUADRUPED.write(tmp_path / "walker.urdf")
    section = CLIMB[CLIMB.index("  urdf") : CLIMB.index("terrain")].replace("\n  ", "\n")
    (tmp_path / "robot.yaml").write_text(f"kind: robot\n{section.strip()}\n")
    with pytest.raises(SpecError, match=r"robot\.yaml:2: urdf: expected limbs of coxa, femur and"):
        load_robot(tmp_path / "robot.yaml")
