"""Simulated links weigh what the URDF says: mass, centre and gravity as Pinocchio has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.control.feedforward import (
    compute_gravity_torques,
    compute_links_wrench,
)
from climbplan.climb.simulation.model.chain_limb import name_motors
from climbplan.climb.simulation.model.link_masses import LinkMasses, select_link_masses
from climbplan.climb.simulation.model.mjcf import build_mjcf
from climbplan.climb.simulation.study import simulate_plan
from climbplan.errors import UsageError
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.simulation.conditions import NOMINAL, Conditions, require_possible
from climbplan.simulation.request import SimulationRequest

SPECS = Path(__file__).parents[2] / "specs"


@pytest.fixture(scope="module", name="plan")
def _plan() -> ClimbPlan:
    return plan_climb(
        load_climb(SPECS / "climb_biped.yaml", ["task.rounds=1", "task.goal.com=[0,0.1,0.52]"])
    )


@pytest.fixture(scope="module", name="found")
def _found() -> UrdfModel:
    robot = load_any_robot(SPECS / "robot_biped.yaml")
    assert isinstance(robot, UrdfRobot)
    return build_urdf_model(robot)


def weights_of(plan: ClimbPlan) -> LinkMasses:
    found = select_link_masses(plan, NOMINAL)
    assert found is not None
    return found


def named(plan: ClimbPlan, angles: np.ndarray) -> dict[str, float]:
    names = plan.robot.limbs.joint_names
    return {
        n: float(a)
        for own, row in zip(names, angles, strict=True)
        for n, a in zip(own, row, strict=True)
    }


def test_masses_are_the_urdfs(plan: ClimbPlan, found: UrdfModel) -> None:
    weights = weights_of(plan)
    assert weights.mass.sum() + weights.body_mass == pytest.approx(found.compute_mass(), abs=1e-9)
    assert weights.mass.sum() == pytest.approx(8.6, abs=1e-9)
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, NOMINAL))
    assert model.body_mass.sum() == pytest.approx(found.compute_mass(), abs=1e-6)


def test_the_centre_of_mass_moves_as_pinocchios(plan: ClimbPlan, found: UrdfModel) -> None:
    robot = plan.robot
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, NOMINAL))
    data = mujoco.MjData(model)
    names = [name for limb in range(2) for name in name_motors(robot, limb)]
    address = [model.joint(name).qposadr[0] for name in names]
    rng = np.random.default_rng(0)
    zero = found.compute_center({})
    for _ in range(5):
        angles = rng.uniform(robot.joint_lower, robot.joint_upper)
        data.qpos[3:7] = [1, 0, 0, 0]
        data.qpos[address] = angles.ravel()
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        own = data.subtree_com[model.body("body").id].copy()
        data.qpos[address] = 0.0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        moved = own - data.subtree_com[model.body("body").id]
        np.testing.assert_allclose(
            moved, found.compute_center(named(plan, angles)) - zero, atol=2e-6
        )


def test_motors_carry_links_as_pinocchio_says(plan: ClimbPlan, found: UrdfModel) -> None:
    told = compute_gravity_torques(plan, NOMINAL)
    wrench = compute_links_wrench(plan, NOMINAL)
    angles = compute_true_angles(plan, sample_instants(plan))
    model, data = found.model, found.model.createData()
    chain = plan.robot.mechanism
    assert isinstance(chain, SerialChain)
    posture, moved = chain.posture, 0.0
    for sample in (0, len(told) // 2, len(told) - 1):
        q = found.build_configuration(named(plan, angles[sample]))
        up = found.root_to_base_rotation.T @ rotation_world_body(plan.trajectory.rpy[sample])[2]
        model.gravity.linear = -plan.robot.gravity * up
        held = pin.computeGeneralizedGravity(model, data, q)
        for limb, own in enumerate(plan.robot.limbs.joint_names):
            for joint, name in enumerate(own):
                index = model.idx_vs[model.getJointId(name)]
                assert told[sample, limb, joint] == pytest.approx(held[index], abs=1e-6)
        # All mass counts to the body's origin, where it acts as the robot stands
        centre = found.compute_center(named(plan, angles[sample])) - found.compute_center(
            named(plan, posture)
        )
        turned = rotation_world_body(plan.trajectory.rpy[sample])
        moment = np.cross(turned @ centre, [0.0, 0.0, -plan.robot.weight])
        np.testing.assert_allclose(wrench[sample, 3:], moment, atol=1e-5)
        moved = max(moved, float(np.linalg.norm(centre)))
    assert moved > 0.004  # legs that stay behind take it along
    model.gravity.linear = np.array([0.0, 0.0, -9.81])


def test_a_share_that_is_given_counts(plan: ClimbPlan) -> None:
    assert select_link_masses(plan, Conditions(limb_mass_share=0.02)) is None


def test_load_taken_off_leaves_a_body(plan: ClimbPlan) -> None:
    weights = weights_of(plan)
    with pytest.raises(UsageError, match=r"expected at least -7\.17 kg"):
        require_possible(Conditions(payload=-8.0), plan.robot.mass, float(weights.mass.sum()))


def test_plans_that_do_not_say_what_links_weigh_are_told_of(
    plan: ClimbPlan, caplog: pytest.LogCaptureFixture
) -> None:
    before = replace(plan, robot=replace(plan.robot, links=None))
    with pytest.raises(UsageError):  # of the payload, after the warning
        simulate_plan(before, SimulationRequest(Conditions(payload=-100.0)))
    assert "does not say what the links of its URDF weigh" in caplog.text
    assert "2 % of the mass together" in caplog.text
