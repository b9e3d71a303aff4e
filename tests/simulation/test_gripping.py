"""Robots with grippers in MuJoCo: linkages close, grips bear what is planned, and let go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from climbplan.cli.app import run
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.comparison import compare
from climbplan.climb.simulation.control.feedforward import (
    _differentiate_potential,
    compute_gravity_torques,
)
from climbplan.climb.simulation.grips.gripping import distribute_grip_force
from climbplan.climb.simulation.model.chain_limb import name_motors
from climbplan.climb.simulation.model.linkage_limb import compute_elbow_angles
from climbplan.climb.simulation.model.mjcf import build_mjcf, compute_link_mass
from climbplan.climb.simulation.replay import simulate
from climbplan.mechanics.grip import grip_cones
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import toe_world
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import NOMINAL

SPECS = Path(__file__).parents[2] / "specs"
SHORT = ["task.rounds=1", "task.goal.com=[0,-0.3595,0.075]"]


@pytest.fixture(scope="module", name="plan")
def _plan() -> ClimbPlan:
    return plan_climb(load_climb(SPECS / "climb_single_wall.yaml", SHORT))


def test_the_linkage_is_the_robots(plan: ClimbPlan) -> None:
    robot, moving = plan.robot, plan.trajectory
    assert isinstance(robot.mechanism, FiveBar)
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, NOMINAL))
    data = mujoco.MjData(model)
    angles = compute_true_angles(plan, sample_instants(plan))
    for sample in range(0, len(moving.time), 40):
        data.qpos[:3] = moving.com[sample]
        mujoco.mju_mat2Quat(data.qpos[3:7], rotation_world_body(moving.rpy[sample]).ravel())
        for limb, elbow in enumerate(compute_elbow_angles(robot, angles[sample])):
            for joint, name in enumerate(name_motors(robot, limb)):
                data.qpos[model.joint(name).qposadr[0]] = angles[sample, limb, joint]
            data.qpos[model.joint(f"elbow{limb}").qposadr[0]] = elbow
        mujoco.mj_forward(model, data)
        toes = np.array([data.geom(f"toe{limb}").xpos for limb in range(4)])
        expected = toe_world(robot, moving.com[sample], moving.rpy[sample], angles[sample])
        assert toes == pytest.approx(expected, abs=1e-9)
        assert data.ten_length == pytest.approx(robot.mechanism.linkage.coupler, abs=1e-8)


def test_links_weights_by_differences_are_those_by_axes() -> None:
    plan = plan_climb(load_climb(SPECS / "climb_steps.yaml", ["task.rounds=6"]))
    angles = compute_true_angles(plan, sample_instants(plan))
    rotation = rotation_world_body(plan.trajectory.rpy)
    found = _differentiate_potential(
        plan.robot, rotation, angles, compute_link_mass(plan.robot, NOMINAL)
    )
    assert found == pytest.approx(compute_gravity_torques(plan, NOMINAL), abs=1e-7)


def test_a_wall_is_climbed_and_bears_what_was_planned(plan: ClimbPlan) -> None:
    run = simulate(plan, NOMINAL)
    compared = compare(plan, run)
    assert not run.fallen
    assert run.grips is not None
    assert run.grips.failures == ()
    assert compared.lost_contacts == ()
    assert np.median(compared.torque_error) < 0.02
    # At rest, with all grippers closed, grips carry the weight
    still = np.flatnonzero(run.touching.all(axis=1))[5]
    total = run.force[still].sum(axis=0)
    assert total == pytest.approx([0, 0, plan.robot.weight], abs=0.05 * plan.robot.weight)
    used = (compared.friction / compared.mu).max()
    assert 0.5 < used < 1.0


def test_holds_smoother_than_the_safety_factor_let_go(
    plan: ClimbPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = simulate(plan, replace(NOMINAL, friction=0.8))
    assert not held.fallen
    write_climb(plan, tmp_path / "plan.h5")
    line = ("simulate", str(tmp_path), "-o", str(tmp_path / "out"), "--no-pictures")
    assert run((*line, "--friction", "0.6", "--json")) == 5  # 1 / S_mu is 0.67
    assert "slips off its hold" in capsys.readouterr().out
    assert "Grips that let go" in (tmp_path / "out" / "report.html").read_text()


def test_the_statics_engine_says_that_it_does_not_know_grippers(
    plan: ClimbPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_climb(plan, tmp_path / "plan.h5")
    line = ("simulate", str(tmp_path), "-o", str(tmp_path / "out"), "--no-pictures")
    assert run((*line, "--worlds", "2", "--engine", "statics")) == 2
    assert "has grippers, which the statics engine does not know" in capsys.readouterr().err


@pytest.mark.parametrize("pull", [10.0, 60.0])
def test_what_a_grip_lacks(pull: float) -> None:
    """Sides that stand up: fingers resist a pull by mu g + sigma / 2 each."""
    normal, axis = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    gripping, mu, spines = 20.0, 0.9, 6.0
    cones = grip_cones(normal, axis, np.array(0.0), np.array(mu), np.array(spines))
    force = -pull * normal  # on the gripper, off the wall: what holds it points to the wall
    parts = np.stack([np.zeros(3), force / 2 + gripping * axis, force / 2 - gripping * axis])
    lacking, palm = distribute_grip_force(cones, parts)
    # With e to spare everywhere the palm may pull by e as well
    expected = max((pull / 2 - mu * gripping - spines / 2) / 1.5, 0.0)
    assert lacking == pytest.approx(expected, abs=1e-5)
    if expected:
        assert palm @ normal == pytest.approx(-lacking, abs=1e-4)


def test_stated_friction_is_kept_beside_the_safety_factor() -> None:
    stated = ["uncertainty.friction={uniform: [-0.2, 0.2]}"]
    spec = load_climb(SPECS / "climb_single_wall.yaml", stated).spec
    assert 1 / (1 - spec.margins.slip) == pytest.approx(1.5 / 0.8)
