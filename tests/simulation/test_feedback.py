"""What the regulator from joint angles does by default, late and with poor sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.simulation.control.odometry import find_trusted_toes
from climbplan.climb.simulation.control.regulator import Regulator, build_internal_projector
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.simulation.worlds.nominal_world import build_nominal_world
from climbplan.mechanics.stiffness import limb_compliance
from climbplan.robots.kinematics import rigid_motion
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import NOMINAL, Conditions, select_regulator

Planned = Callable[..., ClimbPlan]


def test_joints_are_the_default(planned: Planned) -> None:
    assert NOMINAL.regulator is None
    assert select_regulator(NOMINAL, planned().robot) == "joints"


def test_a_toe_counts_once_it_has_landed(planned: Planned) -> None:
    """Toes trail their commands: a fast one is still in the air when it should touch."""
    plan = planned()
    time, trusted = plan.trajectory.time, find_trusted_toes(plan)
    landings = np.diff(plan.trajectory.contact.astype(int), axis=0) == 1
    samples, limbs = np.nonzero(landings)
    assert len(samples) > 3
    for sample, limb in zip(samples + 1, limbs, strict=True):
        is_landing = (time >= time[sample]) & (time < time[sample] + 0.19)
        assert not trusted[is_landing, limb].any()
    assert trusted[plan.trajectory.contact].mean() > 0.6


def test_nothing_new_is_corrected_while_a_toe_takes_load(planned: Planned) -> None:
    plan = planned()
    loading = (find_trusted_toes(plan) != plan.trajectory.contact).any(axis=1)
    assert 0.05 < loading.mean() < 0.95
    low = plan.trajectory.com - [0.0, 0.0, 0.01]  # a body that hangs a centimetre low
    for sample, moves in (
        (int(np.flatnonzero(loading)[0]), False),
        (int(np.flatnonzero(~loading)[0]), True),
    ):
        regulator = Regulator(plan, correct_position=True)
        lag = bent(plan)[sample]
        regulator.compute_correction(sample, 0.1, (low[sample], np.eye(3)), lag)
        standing_toes = plan.trajectory.contact[sample]
        assert (regulator.offset[standing_toes, 2] < -1e-4).all() == moves


def bent(plan: ClimbPlan) -> Array:
    """(T, N, J) how far joints lag behind commands where all goes as planned."""
    return np.asarray(
        compute_true_angles(plan, sample_instants(plan)) - plan.trajectory.joint_command
    )


def test_a_toe_that_presses_too_little_is_moved_on_and_its_own_offset_ends_in_the_air(
    planned: Planned,
) -> None:
    plan = planned()
    moving = plan.trajectory
    regulator = Regulator(plan, correct_position=True)
    pose = moving.com[0], rotation_world_body(moving.rpy[0])
    as_planned = regulator.compute_correction(0, 0.1, pose, bent(plan)[0])
    np.testing.assert_allclose(as_planned, 0.0, atol=1e-9)
    lag = bent(plan)[0].copy()
    lag[0] = 0.0  # nothing there to press on
    regulator.compute_correction(0, 0.1, pose, lag)
    into = -np.einsum("ni,ni->n", regulator.offset, plan.instants.normal[0])
    assert into.argmax() == 0
    assert into[0] > 1e-4
    flying = int(np.flatnonzero(~moving.contact.all(axis=1))[0])
    limb = int(np.flatnonzero(~moving.contact[flying])[0])
    regulator.offset[:] = 0.01
    here = moving.com[flying], rotation_world_body(moving.rpy[flying])
    regulator.compute_correction(flying, 0.1, here, bent(plan)[flying])
    length = np.linalg.norm(regulator.offset, axis=1)
    assert length[limb] < 0.8 * 0.01 * np.sqrt(3)
    assert (np.delete(length, limb) > 0.9 * 0.01 * np.sqrt(3)).all()


def test_what_a_motion_of_the_body_explains_is_no_force_between_toes(planned: Planned) -> None:
    plan = planned()
    regulator = Regulator(plan, correct_position=True)
    arms, stands = regulator.tables.arms[0], np.array([True, True, False, True, True, True])
    compliance = limb_compliance(plan.robot, regulator.tables.jacobian[0])
    sharing = build_internal_projector(compliance, arms, stands)
    motion = (rigid_motion(arms) @ np.arange(1.0, 7.0)) * stands[:, None]
    np.testing.assert_allclose(sharing @ motion.ravel(), 0.0, atol=1e-9)
    assert not sharing[6:9].any()
    once = sharing @ np.arange(18.0)
    np.testing.assert_allclose(sharing @ once, once, atol=1e-9)  # a projection


@pytest.mark.parametrize("off", [-5e-3, 5e-3])
def test_walls_that_lie_elsewhere_do_not_fell_a_regulated_climb(
    planned: Planned, off: float
) -> None:
    pytest.importorskip("mujoco")
    plan = planned()
    count = len(plan.terrain.surfaces)
    world = replace(build_nominal_world(plan), surface=np.full(count, off))
    run = simulate(plan, Conditions(world=world, speed=2.0))
    assert not run.fallen
    assert np.abs(run.com - plan.trajectory.com).max() < 20e-3


@pytest.mark.parametrize(
    "world",
    [
        {"delay": 0.05},
        {"joint_noise": np.deg2rad(0.05), "noise_seed": 1},
    ],
)
def test_late_and_with_poor_sensors_it_still_carries_a_payload(
    planned: Planned, world: dict[str, float]
) -> None:
    pytest.importorskip("mujoco")
    plan = planned()
    runs = [
        simulate(plan, Conditions(payload=0.5, speed=2.0, **own))  # type: ignore[arg-type]
        for own in ({"regulator": "nothing"}, {}, world)
    ]
    blind, exact, poor = (np.abs(run.com[-1] - plan.trajectory.com[-1]).max() for run in runs)
    assert not any(run.fallen for run in runs)
    assert exact < blind
    assert poor < blind
    # And it is not the same run
    assert not np.array_equal(runs[1].com, runs[2].com)
