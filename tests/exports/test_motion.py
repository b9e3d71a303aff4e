"""What controllers are told: rates, gains and torques."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.exports.motion import read_motion as climb_motion
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.simulation.replay import simulate
from climbplan.errors import SpecError, UsageError
from climbplan.exports.formats import ControllerOptions, adapt_motion
from climbplan.exports.motion import ExportedJoints, RobotMotion
from climbplan.limms.exports.motion import read_motion as limms_motion
from climbplan.robots.any_robot import build_robot
from climbplan.schema.loading import load_spec
from climbplan.simulation.conditions import Conditions
from climbplan.walking.exports.motion import read_motion as walk_motion

SPECS = Path(__file__).parents[2] / "specs"


def joints(motion: RobotMotion) -> ExportedJoints:
    assert motion.joints is not None
    return motion.joints


def test_the_plans_own_samples_are_kept_to_the_last_bit(plans: dict[str, Path]) -> None:
    plan, motion = read_climb(plans["climb"]), climb_motion(plans["climb"])
    at_plan = adapt_motion(motion, ControllerOptions(rate=20.0))  # what the plan is sampled at
    for one in (motion, at_plan):
        assert np.array_equal(one.time, plan.trajectory.time)
        commands = plan.trajectory.joint_command.reshape(len(one.time), -1)
        assert np.array_equal(joints(one).command, commands)
        assert np.array_equal(one.bodies[0].position, plan.trajectory.com)
    fine = adapt_motion(motion, ControllerOptions(rate=100.0))
    assert np.array_equal(joints(fine).command[::5], joints(motion).command)


def test_velocities_and_accelerations_are_those_of_the_commands(plans: dict[str, Path]) -> None:
    fine = joints(adapt_motion(climb_motion(plans["climb"]), ControllerOptions(rate=1000.0)))
    step = 1e-3
    moved = (fine.command[2:] - fine.command[:-2]) / (2 * step)
    assert np.abs(moved - fine.velocity[1:-1]).max() < 1e-3 * np.abs(fine.velocity).max() + 1e-9
    assert np.abs(fine.velocity[[0, -1]]).max() < 1e-12  # it begins and ends at rest


def test_torques_are_the_planned_ones_at_the_instants(plans: dict[str, Path]) -> None:
    """Where all limbs stand, tau = -J^T f of the plan, and forces come back from them."""
    plan, motion = read_climb(plans["climb"]), climb_motion(plans["climb"])
    assert motion.contacts is not None
    weight = motion.contacts.force.sum(axis=1)
    standing = motion.contacts.touching.all(axis=1)
    assert weight[standing, 2] == pytest.approx(plan.robot.weight, rel=5e-3)
    first = -plan.forces.joint_torques[0].ravel()
    assert np.abs(joints(motion).torque - first).max(axis=1).min() < 0.05


def test_other_gains_bring_the_same_torques(plans: dict[str, Path]) -> None:
    motion = climb_motion(plans["climb"])
    own = joints(motion)
    for gains in (20.0, 300.0):
        other = joints(adapt_motion(motion, ControllerOptions(gains=str(gains))))
        torque = gains * (other.command - own.angle)
        assert torque == pytest.approx(own.torque, abs=1e-9)
    apart = joints(adapt_motion(motion, ControllerOptions(feedforward=True)))
    assert np.array_equal(apart.command, own.angle)
    assert np.array_equal(apart.feedforward, own.torque)
    same = joints(adapt_motion(motion, ControllerOptions(gains=str(float(own.gain[0])))))
    assert same.command == pytest.approx(own.command, abs=1e-12)


@pytest.mark.parametrize("factor", [0.6, 2.0])
def test_a_controller_with_other_gains_holds_the_climb(
    plans: dict[str, Path], tmp_path: Path, factor: float
) -> None:
    """In MuJoCo by PD on the joints: with commands for its gains it ends where the plan does."""
    pytest.importorskip("mujoco")
    plan = read_climb(plans["climb"])
    # MuJoCo's joints are motors alone: the same springs without the structure's part
    share, stiffness = plan.robot.structural_compliance_share, plan.robot.joint_stiffness
    robot = replace(
        plan.robot, structural_compliance_share=0.0, joint_stiffness=stiffness * (1 - share)
    )
    rigid = replace(plan, robot=robot)
    write_climb(rigid, tmp_path / "rigid.h5")
    own = robot.joint_stiffness[0, 0]
    assert (robot.joint_stiffness == own).all()
    other = adapt_motion(
        climb_motion(tmp_path / "rigid.h5"), ControllerOptions(gains=str(float(own * factor)))
    )

    def departure(command: np.ndarray, gain: float) -> float:
        moving = replace(rigid.trajectory, joint_command=command.reshape(stiff.shape))
        run = simulate(replace(rigid, trajectory=moving), Conditions(gain=gain))
        return np.inf if run.fallen else float(np.abs(run.com[-1] - moving.com[-1]).max())

    stiff = rigid.trajectory.joint_command
    nominal = departure(stiff, 1.0)
    right = departure(joints(other).command, factor)
    assert right < nominal + 4e-3
    assert departure(stiff, factor) > right + 2e-3


def test_joints_of_a_urdf_have_its_names() -> None:
    loaded = load_spec(SPECS / "climb_walker.yaml")
    robot = build_robot(loaded.robot)
    text = (SPECS / "walker.urdf").read_text(encoding="utf-8")
    names = robot.motor_names
    assert len(names) == len(set(names)) == int(robot.has_joint.sum())
    assert all(f'<joint name="{name}"' in text for name in names)


def test_modules_and_walks(plans: dict[str, Path]) -> None:
    modules, walk = limms_motion(plans["modules"]), walk_motion(plans["walk"])
    assert (np.diff(modules.time) > 0).all()
    assert joints(modules).names[0].endswith("_joint1")
    assert walk.joints is None
    assert walk.contacts is not None
    for motion in (modules, walk):
        fine = adapt_motion(motion, ControllerOptions(rate=200.0))
        assert fine.time[-1] == motion.time[-1]
        assert np.allclose(np.linalg.norm(fine.bodies[0].quaternion, axis=1), 1.0)
    with pytest.raises(UsageError, match="modules have no mass"):
        adapt_motion(modules, ControllerOptions(gains="20"))
    with pytest.raises(UsageError, match="joints are its controller's"):
        adapt_motion(walk, ControllerOptions(feedforward=True))


@pytest.mark.parametrize("rate", [0.0, -1.0, 1e9, float("nan"), float("inf")])
def test_rates_that_cannot_be(plans: dict[str, Path], rate: float) -> None:
    with pytest.raises(UsageError, match="--rate"):
        adapt_motion(walk_motion(plans["walk"]), ControllerOptions(rate=rate))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("RF_coxa: 10", "RF_femur is missing; RF_tibia is missing"),
        ("- 1", "expected `joint: gain`"),
        ("a: [", "not valid YAML"),
        ("!!python/object/apply:os.system ['true']", "expected `joint: gain`"),
        ("LF_knee: 10", "no joint 'LF_knee'"),
        ("RF_coxa: -1\nRF_femur: .nan\nRF_tibia: yes", "RF_coxa: -1 is no positive number"),
    ],
)
def test_gains_of_a_file(plans: dict[str, Path], tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "gains.yaml"
    path.write_text(text, encoding="utf-8")
    motion = climb_motion(plans["climb"])
    with pytest.raises((UsageError, SpecError)) as refused:
        adapt_motion(motion, ControllerOptions(gains=str(path)))
    assert words in str(refused.value)
    for given in ("0", "-3", "nan", "inf", str(tmp_path / "none.yaml")):
        with pytest.raises(UsageError, match=r"--gains|cannot be read"):
            adapt_motion(motion, ControllerOptions(gains=given))
    names = joints(motion).names
    path.write_text("".join(f"{name}: {30 + k}\n" for k, name in enumerate(names)))
    assert (
        joints(adapt_motion(motion, ControllerOptions(gains=str(path)))).gain[-1]
        == 30 + len(names) - 1
    )
