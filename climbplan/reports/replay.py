"""The plan's trajectory as the fewest frames that play it back faithfully."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports.patches import limb_points
from climbplan.robots.kinematics import standing_inverse

TOLERANCE = 1e-3  # [m] largest error of any joint when played by linear interpolation
START = -1  # instant of samples before the first lift


@dataclass(frozen=True)
class Replay:
    """Frames to interpolate linearly; joints are femur joint, knee and toe."""

    time: Array  # (F,) [s]
    com: Array  # (F, 3) [m]
    rpy: Array  # (F, 3) [rad]
    joints: Array  # (F, N, 3, 3) [m], world
    contact: BoolArray  # (F, N)
    angles: Array  # (F, N, J) [rad] that the joints have
    instant: IntArray  # (F,) planned instant whose forces act, START before the first


def sample_instants(plan: ClimbPlan) -> IntArray:
    """The planned instant (T,) that each trajectory sample belongs to.

    A limb in the air belongs to the instant at which it is lifted, what follows to the push after
    it. START before the first lift.
    """
    contact, lifted = plan.trajectory.contact, plan.instants.lifted
    changes = np.flatnonzero((contact[1:] != contact[:-1]).any(axis=1)) + 1
    found = np.full(len(contact), START, np.int64)
    k = START
    for first, last in zip([0, *changes], [*changes, len(contact)], strict=True):
        airborne = ~contact[first]
        if airborne.any():
            later = np.flatnonzero((lifted == airborne).all(axis=1))
            later = later[later > k]
            k = int(later[0]) if len(later) else k
        elif k >= 0 and lifted[k].any() and k + 1 < len(lifted):
            k += 1
        found[first:last] = k
    return found


def true_angles(plan: ClimbPlan, instant: IntArray) -> Array:
    """Joint angles (T, N, 3) with toes in contact where they stand, not where they are commanded.

    Commands press toes into the terrain; the toes stay on its surface. Limbs in the air follow
    their commands, as does a limb whose foothold the sample's body pose cannot reach.
    """
    moving, instants = plan.trajectory, plan.instants
    stand = np.concatenate([plan.rounds.toes[:1], instants.toes])[instant + 1]  # (T, N, 3)
    standing = np.concatenate([np.ones((1, plan.robot.limb_count), bool), instants.contact])
    held = moving.contact & standing[instant + 1]
    normal = np.concatenate([instants.normal[:1], instants.normal])[instant + 1]
    solution = standing_inverse(plan.robot, moving.com, moving.rpy, stand, normal)
    return np.where((held & solution.valid)[..., None], solution.best(), moving.joint_command)


def key_frames(time: Array, values: Array, forced: BoolArray, tolerance: float) -> IntArray:
    """Indices of samples between which linear interpolation errs by at most `tolerance`.

    time: (T,); values: (T, D); forced: (T,) samples that must be kept. Splits at the worst sample
    until none is off (Ramer, Douglas, Peucker).
    """
    keep = forced.copy()
    keep[[0, -1]] = True
    kept = np.flatnonzero(keep)
    open_spans = list(pairwise(kept))
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        inside = slice(first + 1, last)
        share = (time[inside] - time[first]) / (time[last] - time[first])
        straight = values[first] + share[:, None] * (values[last] - values[first])
        error = np.abs(values[inside] - straight).max(axis=1)
        worst = int(np.argmax(error))
        if error[worst] > tolerance:
            split = first + 1 + worst
            keep[split] = True
            open_spans += [(first, split), (split, last)]
    return np.flatnonzero(keep)


def build_replay(plan: ClimbPlan) -> Replay:
    """Frames of a plan's trajectory."""
    moving = plan.trajectory
    instant = sample_instants(plan)
    angles = true_angles(plan, instant)
    points = limb_points(plan, moving.com, moving.rpy, angles)
    values = np.column_stack([moving.com, points[:, :, 1:].reshape(len(moving.time), -1)])
    # Both sides of a change of contact or instant stay, so that it shows when it happens.
    change = (np.diff(moving.contact, axis=0) != 0).any(axis=1) | (np.diff(instant) != 0)
    forced = np.concatenate([[False], change]) | np.concatenate([change, [False]])
    frames = key_frames(moving.time, values, forced, TOLERANCE)
    return Replay(
        time=moving.time[frames],
        com=moving.com[frames],
        rpy=moving.rpy[frames],
        joints=points[frames][:, :, 1:],
        contact=moving.contact[frames],
        angles=angles[frames],
        instant=instant[frames],
    )
