"""Rotor inertia, damping and friction of joints: robot files, URDF and MJCF, limits of motors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mjcf_walkers import mjcf_of
from urdf_walkers import Walker

from climbplan.errors import SpecError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.joint_dynamics import JointDynamics, default_damping, default_rotor_inertia
from climbplan.robots.model import dynamics_of
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.tree import parse_urdf
from climbplan.schema.robots.xml import UrdfFaults

pytest.importorskip("pinocchio")
SPECS = Path(__file__).parents[2] / "specs"
WALKER = Walker()


def dynamics(folder: Path, lines: str = "", text: str = "") -> JointDynamics:
    """Of a walker of three joints a leg, 60 N m and 5 rad/s each, and lines of its robot file."""
    (folder / "walker.urdf").write_text(text or WALKER.text())
    legs = "".join(f"  {n}: {{toe: {n}_toe}}\n" for n in WALKER.names())
    path = folder / "robot.yaml"
    path.write_text(f"kind: robot\nurdf: walker.urdf\n{lines}legs:\n{legs}")
    return dynamics_of(build_robot(load_any_robot(str(path))))


def test_a_gear_does_not_change_the_time_in_which_a_motor_is_up_to_speed() -> None:
    torque, speed, rotor = 1.3, 200.0, 6e-5
    constant = rotor * speed / torque
    for ratio in (1.0, 6.0, 50.0):
        felt = ratio**2 * rotor
        assert felt * (speed / ratio) / (ratio * torque) == pytest.approx(constant)
    both = default_rotor_inertia(np.array([33.5, 33.5]), np.array([21.0, 1e9]))
    assert both[0] == pytest.approx(0.01, rel=0.1)  # A1's, as MuJoCo Menagerie has it
    assert both[1] == pytest.approx(0.006 * 33.5 / 60)  # a limit that is none


def test_nothing_stated_is_by_limits_of_torque_and_speed(tmp_path: Path) -> None:
    found = dynamics(tmp_path, "structural_compliance_share: 0.2\n")
    assert found.rotor_inertia == pytest.approx(np.full((4, 3), 0.006 * 60 / 5))
    assert found.damping == pytest.approx(2 * np.sqrt(0.8 * 50 * 0.072))
    assert not found.viscous_friction.any()
    assert not found.dry_friction.any()


def test_the_robot_file_says_more_of_all_joints_and_of_one(tmp_path: Path) -> None:
    lines = (
        "joint_rotor_inertia: 0.01\njoint_damping: 1.5\n"
        "joints: {L1_knee: {rotor_inertia: 0.02, damping: 0}, R1_yaw: {stiffness: 200}}\n"
    )
    found = dynamics(tmp_path, lines)
    inertia, damping = np.full((4, 3), 0.01), np.full((4, 3), 1.5)
    inertia[0, 2], damping[0, 2] = 0.02, 0.0
    assert found.rotor_inertia == pytest.approx(inertia)
    assert found.damping == pytest.approx(damping)


def test_stated_rotors_are_damped_critically(tmp_path: Path) -> None:
    found = dynamics(tmp_path, "joints: {L1_knee: {rotor_inertia: 0.02, stiffness: 80}}\n")
    assert found.damping[0, 2] == pytest.approx(default_damping(np.array(80.0), np.array(0.02)))


@pytest.mark.parametrize(
    ("line", "key", "expected"),
    [
        ("joint_rotor_inertia: 1e-9\n", "joint_rotor_inertia", "from 1e-07 to 100000 kg m^2"),
        ("joints: {L1_knee: {damping: 1e9}}\n", "joints.L1_knee.damping", "from 0 to 1e+07"),
    ],
)
def test_numbers_out_of_range_are_refused(
    tmp_path: Path, line: str, key: str, expected: str
) -> None:
    with pytest.raises(SpecError) as told:
        dynamics(tmp_path, line)
    assert told.value.mistakes[0].key == key
    assert expected in told.value.mistakes[0].message


def stated(text: str, joint: str, element: str) -> str:
    """A URDF with an element within a joint."""
    start = text.index(f'<joint name="{joint}"')
    end = text.index("</joint>", start)
    return text[:end] + element + text[end:]


def test_friction_is_what_the_urdf_says(tmp_path: Path) -> None:
    text = stated(WALKER.text(), "R1_lift", '<dynamics damping="0.3" friction="0.2"/>')
    found = dynamics(tmp_path, text=text)
    assert found.viscous_friction[1].tolist() == [0, 0.3, 0]
    assert found.dry_friction[1].tolist() == [0, 0.2, 0]
    assert found.viscous_friction.sum() == pytest.approx(0.3)


@pytest.mark.parametrize("value", ["-1", "1e9"])
def test_impossible_friction_is_refused_at_its_line(value: str) -> None:
    text = stated(WALKER.text(), "R1_lift", f'<dynamics friction="{value}"/>')
    with pytest.raises(UrdfFaults) as told:
        parse_urdf(text, Path("walker.urdf"))
    fault = told.value.faults[0]
    assert "<dynamics friction> of joint 'R1_lift': expected 0 to 1e+07" in fault.message
    assert fault.line == 1 + text[: text.index("<dynamics")].count("\n")


def test_armature_and_friction_of_an_mjcf_file_count(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    text = mjcf_of(WALKER).replace(
        '<joint name="L1_knee"',
        '<joint armature="0.03" damping="0.4" frictionloss="0.1" name="L1_knee"',
    )
    assert "armature" in text
    (tmp_path / "walker.xml").write_text(text)
    names = WALKER.names()
    joints = "".join(
        f"  {n}_{k}: {{max_speed: 5}}\n" for n in names for k in ("yaw", "lift", "knee")
    )
    legs = "".join(f"  {n}: {{toe: {n}_toe}}\n" for n in names)
    path = tmp_path / "robot.yaml"
    path.write_text(f"kind: robot\nurdf: walker.xml\njoints:\n{joints}legs:\n{legs}")
    found = dynamics_of(build_robot(load_any_robot(str(path))))
    limb = names.index("L1")
    assert found.rotor_inertia[limb] == pytest.approx([0.072, 0.072, 0.03])
    assert found.viscous_friction[limb, 2] == pytest.approx(0.4)
    assert found.dry_friction[limb, 2] == pytest.approx(0.1)


def test_joints_that_slide_have_theirs_in_kilograms() -> None:
    robot = build_robot(load_any_robot(str(SPECS / "robot_telescope.yaml")))
    found = dynamics_of(robot)
    assert found.rotor_inertia[:, 2] == pytest.approx(0.006 * 400 / 1.2)
    assert found.damping[:, 2] == pytest.approx(2 * np.sqrt(0.7 * 8000 * 2.0))


def test_robots_without_any_have_those_of_their_limits() -> None:
    silvia = build_robot(load_any_robot("silvia"))
    assert dynamics_of(silvia).rotor_inertia == pytest.approx(0.05)
    bare = dynamics_of(replace(silvia, dynamics=None))
    assert bare.rotor_inertia == pytest.approx(0.006 * 25 / 4.7)
    assert bare.damping == pytest.approx(2 * np.sqrt(0.7 * 45 * 0.006 * 25 / 4.7))
