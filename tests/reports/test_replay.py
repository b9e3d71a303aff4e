"""Replay frames: true to the trajectory, with the forces of the right instant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from climbplan.climb.pages.patches import compute_limb_points
from climbplan.climb.pages.replay import TOLERANCE, build_replay
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import START, compute_true_angles, sample_instants
from climbplan.reports.key_frames import select_key_frames
from climbplan.robots.kinematics import solve_inverse_kinematics, to_body, toe_world

MakePlan = Callable[..., ClimbPlan]


def played(time: np.ndarray, frames: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Frames (F, D) interpolated linearly at other times."""
    return np.column_stack([np.interp(at, time, column) for column in frames.T])


@pytest.mark.parametrize(("limbs", "rounds"), [(3, 1), (6, 4), (8, 32)])
def test_frames_play_back_within_tolerance(make_plan: MakePlan, limbs: int, rounds: int) -> None:
    plan = make_plan(limbs, rounds, turn_deg=6.0 if limbs == 6 else 0.0)
    replay = build_replay(plan)
    moving = plan.trajectory
    assert len(replay.time) < len(moving.time)
    assert (replay.time[0], replay.time[-1]) == (moving.time[0], moving.time[-1])
    angles = compute_true_angles(plan, sample_instants(plan))
    truth = compute_limb_points(plan, moving.com, moving.rpy, angles)[:, :, 1:]
    count = len(moving.time)
    shown = played(replay.time, replay.joints.reshape(len(replay.time), -1), moving.time)
    assert np.abs(shown - truth.reshape(count, -1)).max() <= TOLERANCE + 1e-12
    assert np.abs(played(replay.time, replay.com, moving.time) - moving.com).max() <= TOLERANCE


def test_every_instant_is_played_in_order(make_plan: MakePlan) -> None:
    plan = make_plan(6, 3)
    instant = build_replay(plan).instant
    assert instant[0] == START
    changes = instant[np.concatenate([[True], np.diff(instant) != 0])]
    assert list(changes) == [START, *range(plan.instants.count)]


def test_forces_belong_to_the_lifted_limb(make_plan: MakePlan) -> None:
    plan = make_plan(6, 2)
    instant = sample_instants(plan)
    airborne = ~plan.trajectory.contact
    for sample, k in enumerate(instant):
        if airborne[sample].any():
            assert (plan.instants.lifted[k] == airborne[sample]).all()
        elif k != START:
            assert not plan.instants.lifted[k].any()


def test_a_coarse_trajectory_skips_instants_without_losing_count(make_plan: MakePlan) -> None:
    plan = make_plan(6, 2)
    moving = plan.trajectory
    kept = np.arange(0, len(moving.time), 30)  # some limbs' time in the air falls between samples
    names = ("time", "com", "rpy", "joint_command", "contact")
    coarse = replace(moving, **{name: vars(moving)[name][kept] for name in names})
    instant = sample_instants(replace(plan, trajectory=coarse))
    fine = sample_instants(plan)[kept]
    airborne = (~coarse.contact).any(axis=1)
    assert airborne.any()
    assert (instant[airborne] == fine[airborne]).all()


def test_toes_stand_still_although_commands_press_them_in(make_plan: MakePlan) -> None:
    plan = make_plan(6, 2)
    moving = plan.trajectory
    # Commands 30 mm behind the walls while in contact.
    toes = toe_world(plan.robot, moving.com, moving.rpy, moving.joint_command)
    depth = 0.03 * np.sign(toes[..., :1]) * np.array([1.0, 0.0, 0.0]) * moving.contact[..., None]
    pressed = solve_inverse_kinematics(plan.robot, to_body(moving.com, moving.rpy, toes + depth))
    assert pressed.valid.all()
    plan = replace(plan, trajectory=replace(moving, joint_command=pressed.best()))
    replay = build_replay(plan)
    shown = replay.joints[:, :, 2]
    standing = np.stack([plan.rounds.toes[0], *plan.instants.toes])[replay.instant + 1]
    held = (
        replay.contact
        & np.concatenate([np.ones((1, 6), bool), plan.instants.contact])[replay.instant + 1]
    )
    assert np.allclose(shown[held], standing[held], atol=1e-9)
    commanded = toe_world(plan.robot, moving.com, moving.rpy, pressed.best())
    assert np.abs(commanded[..., 0]).max() > np.abs(shown[held][..., 0]).max() + 0.02


def test_key_frames_keep_corners_and_forced_samples_only() -> None:
    time = np.linspace(0, 10, 101)
    corner = np.abs(time - 4.0)[:, None]
    forced = np.zeros(101, bool)
    forced[70] = True
    assert list(select_key_frames(time, corner, forced, 1e-6)) == [0, 40, 70, 100]
