"""Physics agrees with plans where it must, and disagrees where the world is another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.simulation.comparison import compare, find_losses, find_slips
from climbplan.climb.simulation.instant_samples import find_instant_samples
from climbplan.climb.simulation.model.mjcf import build_mjcf
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.transition.planner import plan_transition
from climbplan.robots.kinematics import toe_world
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import NOMINAL, Conditions, FrictionLoss
from climbplan.simulation.measures import compute_tilt
from climbplan.simulation.motors import compute_motor_stiffness
from climbplan.terrain.surfaces import Region, Tube

SPECS = Path(__file__).parents[2] / "specs"
Planned = Callable[..., ClimbPlan]


@pytest.fixture(scope="module")
def mujoco() -> object:
    return pytest.importorskip("mujoco")


def test_model_is_the_robot_of_the_data(planned: Planned, mujoco) -> None:  # type: ignore[no-untyped-def]
    plan = planned()
    robot, conditions = plan.robot, Conditions(limb_mass_share=0.5, gain=1.1)
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, conditions))
    data = mujoco.MjData(model)
    assert model.body_mass.sum() == pytest.approx(robot.mass, rel=1e-3)
    assert model.actuator_gainprm[:, 0].reshape(6, 3) == pytest.approx(
        compute_motor_stiffness(robot, conditions)
    )
    assert model.actuator_forcerange[:, 1].reshape(6, 3) == pytest.approx(robot.max_torque)
    rng = np.random.default_rng(0)
    for _ in range(5):
        angles = rng.uniform(robot.joint_lower, robot.joint_upper)
        com, rpy = rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.3, 0.3, 3)
        data.qpos[:3] = com
        mujoco.mju_mat2Quat(data.qpos[3:7], rotation_world_body(rpy).ravel())
        data.qpos[7:] = angles.ravel()
        mujoco.mj_kinematics(model, data)
        toes = np.array([data.geom(f"toe{limb}").xpos for limb in range(6)])
        np.testing.assert_allclose(toes, toe_world(robot, com, rpy, angles), atol=1e-9)


def test_nominal_climb_is_as_planned(planned: Planned) -> None:
    plan = planned()
    run = simulate(plan, NOMINAL)
    found = compare(plan, run)
    assert not run.fallen
    assert run.samples == len(plan.trajectory.time)
    assert len(found.instant) == plan.instants.count
    assert found.slips == ()
    assert np.median(found.torque_error) < 0.05
    assert (found.friction < found.mu).all()
    assert np.linalg.norm(run.com - plan.trajectory.com, axis=1).max() < 0.005
    # Newton: toes carry the weight, whatever else they press.
    total = run.force[found.sample].sum(axis=1)
    np.testing.assert_allclose(total, [[0, 0, plan.robot.weight]] * len(total), atol=2.0)
    assert (run.normal[found.sample] >= 0).all()


def test_instants_are_found_in_the_motion(planned: Planned) -> None:
    plan = planned()
    at = find_instant_samples(plan)
    assert (np.diff(at) > 0).all()
    for k, sample in enumerate(at):
        np.testing.assert_array_equal(plan.trajectory.contact[sample], plan.instants.contact[k])
        np.testing.assert_allclose(plan.trajectory.com[sample], plan.instants.com[k], atol=1e-6)


def test_less_friction_than_planned_with_ends_in_a_fall(planned: Planned) -> None:
    plan = planned()  # S_mu 1.8: some toe uses mu 0.56
    run = simulate(plan, Conditions(friction=0.4))
    assert run.fallen
    assert run.com[-1, 2] < plan.trajectory.com[run.samples - 1, 2] - 0.1


def test_sag_under_a_payload_is_that_of_the_springs(planned: Planned) -> None:
    plan = planned()
    loaded = compare(plan, simulate(plan, Conditions(payload=0.5, regulator="nothing"), rests=True))
    sag, predicted = loaded.sag[:, 2], loaded.sag_predicted[:, 2]
    assert np.median(predicted) > 0.002
    assert np.median(np.abs(sag - predicted) / predicted) < 0.05
    assert np.median(loaded.sag_error) < 0.05


def test_heavy_limbs_come_down_low_unless_their_weight_is_fed_forward(planned: Planned) -> None:
    plan = planned()
    heavy = Conditions(limb_mass_share=0.5)
    off = []
    for conditions in (heavy, replace(heavy, limb_weights=False)):
        run = simulate(plan, conditions)
        sample = find_instant_samples(plan)[1]  # the first limb has been placed
        limb = int(np.flatnonzero(plan.instants.lifted[0])[0])
        off.append(float((plan.instants.toes[1] - run.toes[sample])[limb, 2]))
    assert abs(off[0]) < 0.006
    assert off[1] > 0.015


def test_a_lost_contact_slips(planned: Planned) -> None:
    plan = planned()
    k = 1
    start = float(plan.trajectory.time[find_instant_samples(plan)[k]])
    run = simulate(plan, Conditions(losses=(FrictionLoss(3, start - 0.5, 0.6),)))
    slipped = {slip.limb for slip in compare(plan, run).slips}
    assert 3 in slipped


def test_tubes_and_polygons_are_walls_at_their_place(planned: Planned, mujoco) -> None:  # type: ignore[no-untyped-def]
    """A ball pressed against each surface rests with its middle on the planned plane."""
    plan = planned()
    right = next(s for s in plan.terrain.surfaces if s.name == "right")
    assert isinstance(right, Region)
    triangle = Region.from_vertices("triangle", right.vertices[:3], 1.0)
    tube = Tube("tube", np.zeros(2), 0.615, -0.5, 0.5, 1.0)
    inside = triangle.vertices.mean(axis=0)
    for surface, point in (
        (right, np.array([0.615, 0.1, 0.2])),
        (triangle, inside),
        (tube, 0.615 * np.array([np.cos(0.3), np.sin(0.3), 0.0])),
    ):
        terrain = replace(plan.terrain, surfaces=(surface,), allowed=plan.terrain.allowed[:, :1])
        model = mujoco.MjModel.from_xml_string(build_mjcf(replace(plan, terrain=terrain), NOMINAL))
        data = mujoco.MjData(model)
        toe = model.geom("toe1").id
        normal = surface.normal_at(point[None])[0]
        for depth, meets in ((-0.001, False), (0.001, True)):
            data.qpos[:] = 0
            data.qpos[3] = 1
            mujoco.mj_kinematics(model, data)
            data.qpos[:3] += point - depth * normal - data.geom_xpos[toe]
            mujoco.mj_forward(model, data)
            touching = [c for c in data.contact if toe in (c.geom1, c.geom2)]
            assert bool(touching) is meets, (surface.name, depth)
            if meets:
                assert touching[0].dist == pytest.approx(-depth, abs=6e-4)


def test_transition_from_the_ground_to_the_walls(mujoco: object) -> None:
    """Several limbs move at once; the published factors leave it standing."""
    plan = plan_transition(load_transition(SPECS / "transition_flat.yaml"))
    run = simulate(plan, Conditions(speed=2.0), rests=True)
    found = compare(plan, run)
    assert not run.fallen
    assert found.slips == ()
    assert found.lost_contacts == ()
    assert len(found.instant) == plan.instants.count
    assert np.median(found.torque_error) < 0.05
    icy = simulate(plan, Conditions(friction=0.6, speed=4.0))
    assert icy.fallen or find_slips(plan, icy)


def test_toes_that_should_press_and_do_not_are_found(planned: Planned) -> None:
    plan = planned()
    run = simulate(plan, NOMINAL)
    assert find_losses(plan, run) == ()
    untouched = replace(run, touching=run.touching & (np.arange(6) != 4))
    assert {lost.limb for lost in find_losses(plan, untouched)} == {4}


def test_regulator_keeps_the_place_that_soft_motors_lose(planned: Planned) -> None:
    plan = planned()
    soft = Conditions(gain=0.9)
    off = {}
    for what in ("nothing", "attitude", "pose"):
        run = simulate(plan, replace(soft, regulator=what))
        assert not run.fallen
        off[what] = float(np.linalg.norm(run.com[-1] - plan.trajectory.com[-1]))
    assert off["nothing"] > 0.005
    assert off["pose"] < 0.3 * off["nothing"]


def test_regulator_levels_a_body_that_hangs_askew(planned: Planned) -> None:
    """A load beside the body that the plan does not know tilts it."""
    plan = planned()
    wrench = plan.instants.external_wrench.copy()
    wrench[:, 3] += 1.0  # [N m] about the axis from wall to wall
    askew = replace(plan, instants=replace(plan.instants, external_wrench=wrench))
    tilt = {}
    for what in ("nothing", "attitude"):
        run = simulate(askew, Conditions(regulator=what))
        wanted = rotation_world_body(plan.trajectory.rpy[: run.samples])
        tilt[what] = float(np.median(compute_tilt(run.rotation, wanted)))
    assert tilt["attitude"] < 0.5 * tilt["nothing"]
