"""Walks simulated with the whole robot: its model against Pinocchio's dynamics, its controller."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from walking_urdf import planned_walk

from climbplan.cli.simulate_options import parse_push
from climbplan.errors import UsageError
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.simulation.conditions import NOMINAL, Conditions
from climbplan.simulation.request import SimulationRequest
from climbplan.walking.plan.swing_trajectory import choose_vertical_fractions
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.whole_body_model import (
    build_whole_body_mjcf,
    build_whole_body_robot,
)
from climbplan.walking.simulation.whole_body_reference import WholeBodyReference
from climbplan.walking.simulation.whole_body_replay import (
    BodyPush,
    WholeBodyRun,
    simulate_whole_body,
)
from climbplan.walking.simulation.whole_body_study import build_report, simulate_whole_body_plan
from climbplan.walking.task.ground import Ground

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("pinocchio")


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> WalkPlan:
    return planned_walk(tmp_path_factory.mktemp("walker"))


@pytest.fixture(scope="module")
def run(plan: WalkPlan) -> WholeBodyRun:
    return simulate_whole_body(plan, NOMINAL)


def test_the_model_moves_as_the_urdf_does(plan: WalkPlan) -> None:
    """Inverse dynamics of MuJoCo's model and of Pinocchio's, at random states, to 1e-6."""
    robot = build_whole_body_robot(plan, NOMINAL)
    model = mujoco.MjModel.from_xml_string(build_whole_body_mjcf(plan, robot, NOMINAL))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_armature[:], model.dof_damping[:], model.dof_frictionloss[:] = 0.0, 0.0, 0.0
    assert model.body_mass.sum() == pytest.approx(robot.mass, rel=1e-9)
    data, found = mujoco.MjData(model), robot.urdf_model
    pin, other = found.library, found.model.createData()
    turn = TO_WALKING @ found.root_to_base_rotation
    rng = np.random.default_rng(1)
    legs = plan.task.legs
    assert legs is not None
    names = [name for own in legs.chain.names for name in own]
    at = [int(model.joint(f"{leg}_{j}").qposadr[0]) for leg in range(4) for j in range(3)]
    dof = [int(model.joint(f"{leg}_{j}").dofadr[0]) for leg in range(4) for j in range(3)]
    for _ in range(3):
        angles, rates, faster = rng.uniform(-0.5, 0.5, (3, 12))
        spin, turning = rng.uniform(-1, 1, (2, 3))  # of the body, in its own axes
        push = rng.uniform(-2, 2, 3)  # [m/s^2] of its origin
        data.qpos[:7] = [0, 0, 1, 1, 0, 0, 0]
        data.qpos[at], data.qvel[dof], data.qacc[dof] = angles, rates, faster
        data.qvel[:3], data.qvel[3:6] = 0.0, spin
        data.qacc[:3], data.qacc[3:6] = push, turning
        mujoco.mj_inverse(model, data)
        # Pinocchio's base moves in its own axes, and tells its acceleration as a spatial one
        q = found.build_configuration(dict(zip(names, angles.tolist(), strict=True)))
        q[3:7] = pin.Quaternion(turn).coeffs()
        v, a = np.zeros(found.model.nv), np.zeros(found.model.nv)
        index = [int(found.model.idx_vs[found.model.getJointId(name)]) for name in names]
        v[3:6], v[index] = turn.T @ spin, rates
        a[:3], a[3:6], a[index] = turn.T @ push, turn.T @ turning, faster
        expected = pin.rnea(found.model, other, q, v, a)
        np.testing.assert_allclose(data.qfrc_inverse[dof], expected[index], atol=1e-6)
        np.testing.assert_allclose(data.qfrc_inverse[:3], turn @ expected[:3], atol=1e-6)
        np.testing.assert_allclose(data.qfrc_inverse[3:6], turn @ expected[3:6], atol=1e-6)


def test_it_walks_within_its_motors(plan: WalkPlan, run: WholeBodyRun) -> None:
    assert not run.fallen
    assert run.samples == plan.task.knots + 1
    assert run.num_unsolved == 0
    assert 0.05 < run.torque.max() < 1.0
    planned = plan.trajectory.state
    assert np.abs(run.com[-1] - planned[-1, :3]).max() < 0.04
    assert (run.pressure[:-1].sum(axis=1) > 0.5 * plan.task.weight).all()


def test_motors_that_are_too_weak_give_no_more_than_they_have(plan: WalkPlan) -> None:
    legs = plan.task.legs
    assert legs is not None
    weak = replace(legs, max_torque=0.08 * legs.max_torque)
    run = simulate_whole_body(replace(plan, task=replace(plan.task, legs=weak)), NOMINAL)
    assert run.torque.max() == pytest.approx(1.0)
    assert run.fallen or np.abs(run.com[-1, 2] - plan.trajectory.state[-1, 2]) > 0.02


def test_a_push_moves_it_and_it_comes_back_to_its_speed(plan: WalkPlan, run: WholeBodyRun) -> None:
    pushed = simulate_whole_body(plan, NOMINAL, (BodyPush(0.1, np.array([0.0, 0.3, 0.0])),))
    apart = pushed.velocity[:, 1] - run.velocity[:, 1]
    assert not pushed.fallen
    assert np.abs(apart).max() > 0.1
    assert np.abs(apart[-1]) < 0.15  # of 0.3 m/s, four steps of its trot later


def test_toes_step_aside_on_their_region(plan: WalkPlan) -> None:
    """As far as the body is off; not beyond the region, and onto its plane."""
    flat = WholeBodyReference(plan)
    leg, way = next((leg, ways[0]) for leg, ways in enumerate(flat.base.swings) if ways)
    time, off = 0.5 * (way.start + way.end), np.array([0.01, 0.02, 0.0])

    def landing(ground: Ground) -> np.ndarray[Any, Any]:
        reference = WholeBodyReference(replace(plan, task=replace(plan.task, ground=ground)))
        reference.compute_swing(leg, time, way.lift_off, off)
        return reference.landing_offset[leg]

    free = landing(plan.task.ground)
    assert free[0] > off[0]
    assert free[1] == pytest.approx(2 * free[0])
    assert free[2] == 0
    room = np.array([[-1.0, way.touchdown[1] - 0.4], [1.0, way.touchdown[1] + 0.005]])
    none = np.zeros((1, 0, 2))
    slope = np.array([[0.2, 0.0]])
    ramp = Ground(("ramp",), room[:1], room[1:], np.zeros(1), 0.8, slope, none)
    moved = landing(ramp)
    np.testing.assert_allclose(moved, [free[0], 0.005, 0.2 * free[0]], atol=1e-9)


def test_toes_at_a_riser_go_up_alone_first(plan: WalkPlan) -> None:
    """Onto the step that a foot stands at; down from it alone at last; away from it at once."""
    lower, upper = np.array([[-1.0, -1.0], [0.3, -1.0]]), np.array([[0.3, 1.0], [1.0, 1.0]])
    stairs = Ground.level(("floor", "step"), lower, upper, np.array([0.0, 0.05]), 0.8)
    reference = WholeBodyReference(replace(plan, task=replace(plan.task, ground=stairs)), 0.03)
    near, up = np.array([0.269, 0.0, 0.0]), np.array([0.6, 0.0, 0.05])

    def alone(left: np.ndarray, lands: np.ndarray) -> tuple[float, float]:
        top = 0.04 + abs(lands[2] - left[2]) / 2
        return choose_vertical_fractions(stairs, left, lands, top, 0.03)

    first, last = alone(near, up)
    assert first > 0
    assert last == 0
    assert alone(up, near) == (last, first)
    assert alone(np.array([0.1, 0.0, 0.0]), up) == (0, 0)
    assert alone(near, np.array([0.0, 0.0, 0.0])) == (0, 0)
    way = reference.base.swings[0][0]
    reference.vertical_fractions[0] = (0.2, 0.0)
    reference.lift_off[0] = way.lift_off
    begun = reference.compute_swing(
        0, way.start + 0.2 * (way.end - way.start), way.lift_off, np.zeros(3)
    )
    np.testing.assert_allclose(begun.position[:2], way.lift_off[:2], atol=1e-9)
    assert begun.position[2] > way.lift_off[2] + 0.3 * way.clearance


def test_what_a_simulation_tells(plan: WalkPlan) -> None:
    asked = SimulationRequest(NOMINAL, pictures=False, pushes=((0.1, (0.1, 0.0, 0.0)),))
    found = simulate_whole_body_plan(plan, asked)
    told = build_report(found)
    report: dict[str, Any] = dict(told.report)
    assert found.relative_velocity_error is not None
    assert report["velocity_off"] == found.relative_velocity_error < 0.5
    assert report["torque"]["most"] == found.run.torque.max()
    assert report["pushes"] == [{"time": 0.1, "velocity": [0.1, 0.0, 0.0]}]
    assert set(told.figures) == {"path", "forces", "torques"}
    assert told.headline.startswith("no fall")
    assert told.end.joint_speed == found.run.speed.max()


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            SimulationRequest(NOMINAL, pictures=False, pushes=((9.0, (0.1, 0.0, 0.0)),)),
            "within the walk's",
        ),
        (SimulationRequest(Conditions(gain=2.0), pictures=False), "--gain"),
    ],
)
def test_what_such_a_walk_does_not_have_is_refused(
    plan: WalkPlan, asked: SimulationRequest, words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        simulate_whole_body_plan(plan, asked)


def test_a_rigid_body_has_no_links(tmp_path: Path, plan: WalkPlan) -> None:
    text = plan.spec_text.replace("robot: robot.yaml", "robot: scaler")
    with pytest.raises(UsageError, match="one rigid body, without links"):
        build_whole_body_robot(replace(plan, spec_text=text), NOMINAL)


@pytest.mark.parametrize("text", ["1.0", "1.0:0,1", "x:0,0,1", "1:0,0,nan"])
def test_pushes_that_are_none_are_told(text: str) -> None:
    with pytest.raises(UsageError, match="expected TIME:VX,VY,VZ"):
        parse_push(text)
    assert parse_push("1.5:0,-0.5,0") == (1.5, (0.0, -0.5, 0.0))
