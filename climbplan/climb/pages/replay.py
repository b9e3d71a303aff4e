"""The plan's trajectory as the fewest frames that play it back faithfully."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.pages.patches import compute_limb_points
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.reports.key_frames import select_key_frames

TOLERANCE = 1e-3  # [m] largest error of any joint when played by linear interpolation


@dataclass(frozen=True)
class ReplayFrames:
    """Frames to interpolate linearly; joints are femur joint, knee and toe."""

    time: Array  # (F,) [s]
    com: Array  # (F, 3) [m]
    rpy: Array  # (F, 3) [rad]
    joints: Array  # (F, N, 3, 3) [m], world
    contact: BoolArray  # (F, N)
    angles: Array  # (F, N, J) [rad] that the joints have
    instant: IntArray  # (F,) planned instant whose forces act, START before the first


def build_replay(plan: ClimbPlan) -> ReplayFrames:
    """Return frames of a plan's trajectory."""
    moving = plan.trajectory
    instant = sample_instants(plan)
    angles = compute_true_angles(plan, instant)
    points = compute_limb_points(plan, moving.com, moving.rpy, angles)
    values = np.column_stack([moving.com, points[:, :, 1:].reshape(len(moving.time), -1)])
    # Both sides of a change of contact or instant stay, so that it shows when it happens.
    change = (np.diff(moving.contact, axis=0) != 0).any(axis=1) | (np.diff(instant) != 0)
    forced = np.concatenate([[False], change]) | np.concatenate([change, [False]])
    frames = select_key_frames(moving.time, values, forced, TOLERANCE)
    return ReplayFrames(
        time=moving.time[frames],
        com=moving.com[frames],
        rpy=moving.rpy[frames],
        joints=points[frames][:, :, 1:],
        contact=moving.contact[frames],
        angles=angles[frames],
        instant=instant[frames],
    )
