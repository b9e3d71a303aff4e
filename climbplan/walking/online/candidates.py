"""Gaits as a tick can use them: what a plan leaves to do, and what legs are able to."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.walking.kernels.feet import each_within
from climbplan.walking.kernels.footing import left_of
from climbplan.walking.offline.footing import footing_of, gait_of
from climbplan.walking.offline.pinned import Iterate
from climbplan.walking.online.attempt import REACH_SLACK
from climbplan.walking.task.task import Gait, WalkTask, WalkTrajectory

_QUICKEST = 8.0  # [m/s^2] that forces within friction change the velocity by


def reachable(task: WalkTask) -> BoolArray:
    """(L,) legs whose toes are in their boxes right now, and may be until the first interval ends.

    The latter where standing toes have to: the body moves on, whatever forces do within that time.
    """
    body, start = task.body, task.start
    dt = (task.first or task.step) if task.whole_stance else 0.0
    room = REACH_SLACK + 0.5 * _QUICKEST * dt**2
    able: BoolArray = each_within(
        body.toe_center, body.toe_half, start.state, start.toes, REACH_SLACK, dt, room
    )
    return able


def usable(task: WalkTask, gait: Gait, able: BoolArray) -> Gait | None:
    """The gait without contacts of legs that cannot stand now; None if too few are left."""
    if not (gait.contact[0] & ~able).any():
        return gait
    contact = gait.contact.copy()
    contact[0] &= able
    if contact[0].sum() < task.least_contacts:
        contact[0] = able  # whatever can stand, stands
    if contact[0].sum() < min(task.least_contacts, int(able.sum())):
        return None
    return gait_of(contact, gait.region)


def continued(last: WalkTrajectory) -> tuple[Gait, Iterate]:
    """What is left of a plan after its first knot, and one more knot of the same rhythm."""
    contact, state, force, spots = left_of(last.gait.contact, last.state, last.force, last.toes)
    return flat_gait(contact), Iterate(state, force, spots)


def motion_of(last: WalkTrajectory) -> Iterate:
    """A plan as a point to linearise about."""
    footing = footing_of(last.gait)
    return Iterate(last.state, last.force[:-1], last.toes[footing.first, footing.leg, :2])


def flat_gait(contact: BoolArray) -> Gait:
    """A gait on a single region."""
    return Gait(np.array(contact, bool), np.zeros(contact.shape, np.int64))
