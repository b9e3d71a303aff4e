"""Limbs that are chains: the model is the robot's, weights are carried, a short climb holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from urdf_walkers import QUADRUPED

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.comparison import compare, find_slips
from climbplan.climb.simulation.control.feedforward import compute_gravity_torques
from climbplan.climb.simulation.model.chain_limb import name_motors
from climbplan.climb.simulation.model.mjcf import build_mjcf, compute_link_mass
from climbplan.climb.simulation.replay import simulate
from climbplan.robots.kinematics import joint_points_body, toe_world
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.examples import read_example, read_example_data
from climbplan.simulation.conditions import NOMINAL, Conditions
from climbplan.simulation.motors import compute_motor_stiffness

SHORT = ["task.rounds=1", "task.goal.com=[0,0,0.05]", "trajectory.speed=0.005"]


@pytest.fixture(scope="module", name="plan")
def _plan(tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    folder = tmp_path_factory.mktemp("walker")
    (folder / "climb.yaml").write_text(read_example("climb_walker"))
    for name, content in read_example_data("climb_walker").items():
        (folder / name).write_bytes(content)
    return plan_climb(load_climb(folder / "climb.yaml", SHORT))


def test_model_is_the_robot_of_the_plan(plan: ClimbPlan) -> None:
    robot, conditions = plan.robot, Conditions(limb_mass_share=0.5, gain=1.1, backlash=0.01)
    for play in (0.0, 0.01):
        own = replace(conditions, backlash=play)
        model = mujoco.MjModel.from_xml_string(build_mjcf(plan, own))
        data = mujoco.MjData(model)
        assert model.body_mass.sum() == pytest.approx(robot.mass, rel=1e-3)
        gain = model.actuator_gainprm[:, 0].reshape(4, 4)
        assert gain == pytest.approx(compute_motor_stiffness(robot, own))
        assert model.actuator_forcerange[:, 1].reshape(4, 4) == pytest.approx(robot.max_torque)
        names = [name for limb in range(4) for name in name_motors(robot, limb)]
        address = [model.joint(name).qposadr[0] for name in names]
        rng = np.random.default_rng(0)
        for _ in range(5):
            angles = rng.uniform(robot.joint_lower, robot.joint_upper)
            com, rpy = rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.3, 0.3, 3)
            data.qpos[:3] = com
            mujoco.mju_mat2Quat(data.qpos[3:7], rotation_world_body(rpy).ravel())
            data.qpos[address] = angles.ravel()
            mujoco.mj_kinematics(model, data)
            toes = np.array([data.geom(f"toe{limb}").xpos for limb in range(4)])
            np.testing.assert_allclose(toes, toe_world(robot, com, rpy, angles), atol=1e-9)


def test_the_body_is_where_it_is(plan: ClimbPlan) -> None:
    """A torso over the hips does not make a box below them; mass acts in the origin."""
    up = np.array([0.0, 0.0, 0.2])
    lifted = replace(plan, robot=replace(plan.robot, body_hull=plan.robot.body_hull + up))
    model = mujoco.MjModel.from_xml_string(build_mjcf(lifted, Conditions(limb_mass_share=0.02)))
    half = np.ptp(plan.robot.body_hull, axis=0) / 2
    box = model.geom("body")
    np.testing.assert_allclose(box.size, half, atol=1e-6)
    middle = plan.robot.body_hull.mean(axis=0) + up
    np.testing.assert_allclose(box.pos, middle, atol=1e-6)
    np.testing.assert_allclose(model.body("body").ipos, 0.0, atol=1e-9)
    assert model.body_mass.sum() == pytest.approx(plan.robot.mass, rel=1e-3)


def test_weights_of_links_by_virtual_work(plan: ClimbPlan) -> None:
    """The torques are the slope of the links' potential energy by the joint angles."""
    robot, conditions = plan.robot, Conditions(limb_mass_share=0.3)
    found = compute_gravity_torques(plan, conditions)
    rest = replace(
        plan,
        forces=replace(plan.forces, force=np.zeros_like(plan.forces.force)),
    )
    angles = plan.instants.joint_angles[0]
    rotation = rotation_world_body(plan.instants.rpy[0])
    weight = compute_link_mass(robot, conditions) * robot.gravity

    def energy(turned: np.ndarray) -> float:
        points = joint_points_body(robot, turned) @ rotation.T
        return float(weight * ((points[:, :-1] + points[:, 1:]) / 2)[..., 2].sum())

    # At the first sample the robot stands as at the start, before any limb is lifted
    start = joint_angles_at_start(rest)
    slope = np.zeros_like(angles)
    for limb, joint in np.ndindex(*angles.shape):
        step = np.zeros_like(angles)
        step[limb, joint] = 1e-6
        slope[limb, joint] = (energy(start + step) - energy(start - step)) / 2e-6
    np.testing.assert_allclose(found[0], slope, atol=1e-3 * np.abs(slope).max())


def joint_angles_at_start(plan: ClimbPlan) -> np.ndarray:
    from climbplan.robots.kinematics import solve_inverse_kinematics, to_body

    rounds = plan.rounds
    return solve_inverse_kinematics(
        plan.robot, to_body(rounds.com[0], rounds.rpy[0], rounds.toes[0])
    ).best()


def test_a_short_climb_is_as_planned(plan: ClimbPlan) -> None:
    """With links of 44 % of the mass, which the plan knows of."""
    run = simulate(plan, NOMINAL, rests=True)
    assert not run.fallen
    assert not find_slips(plan, run)
    assert np.linalg.norm(run.com[-1] - plan.trajectory.com[-1]) < 0.01
    assert run.torque.shape[1:] == (4, 4)
    compared = compare(plan, run)
    assert np.median(compared.torque_error) < 0.02
    assert np.isfinite(compared.sag_predicted).all()


def test_it_stands_where_links_weigh_less_than_planned(plan: ClimbPlan) -> None:
    run = simulate(plan, Conditions(limb_mass_share=0.02))
    assert not run.fallen
    assert np.median(compare(plan, run).torque_error) > 0.02


def test_a_joint_that_a_limb_has_not_stays_at_zero(plan: ClimbPlan) -> None:
    """Under its weight and a push of its motor; the robot is as heavy as before."""
    chain = plan.robot.mechanism
    assert chain is not None
    mixed = replace(chain, names=(("", *chain.names[0][1:]), *chain.names[1:]))  # type: ignore[type-var]
    other = replace(plan, robot=replace(plan.robot, mechanism=mixed))
    whole = mujoco.MjModel.from_xml_string(build_mjcf(plan, NOMINAL))
    model = mujoco.MjModel.from_xml_string(build_mjcf(other, NOMINAL))
    assert model.nv == whole.nv
    assert abs(float(model.body_mass.sum() / whole.body_mass.sum()) - 1) < 0.01
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.5
    for _ in range(400):
        mujoco.mj_step(model, data)
    assert abs(float(data.joint("joint0limb0").qpos[0])) < 2e-3


def test_walkers_are_written_as_shipped(tmp_path: Path) -> None:
    """The example's URDF is the one that tests write."""
    shipped = read_example_data("robot_walker")["walker.urdf"].decode()
    pinned = replace(QUADRUPED, pins=True).text()
    assert shipped.split("<link", 1)[1] == pinned.split("<link", 1)[1]
