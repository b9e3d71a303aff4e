"""Gaits as a tick can use them: what a plan leaves to do, and what legs are able to."""

from __future__ import annotations

import numpy as np

from climbplan.walking.check.truth import toes_in_body
from climbplan.walking.footing import footing_of, gait_of
from climbplan.walking.offline.pinned import Iterate
from climbplan.walking.online.attempt import REACH_SLACK
from climbplan.walking.task import POSITION, Flags, Gait, WalkTask, WalkTrajectory


def reachable(task: WalkTask) -> Flags:
    """(4,) legs whose toes are in their boxes right now."""
    body = task.body
    spots = toes_in_body(task.start.state, task.start.toes)
    beyond = (np.abs(spots - body.toe_center) - body.toe_half).max(axis=1)
    inside: Flags = beyond <= REACH_SLACK
    return inside


def usable(task: WalkTask, gait: Gait, able: Flags) -> Gait | None:
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
    contact = np.vstack([last.gait.contact[1:], last.gait.contact[-2:-1]])
    gait = flat_gait(contact)
    extended = last.state[-1:].copy()
    step = last.state[-1, POSITION] - last.state[-2, POSITION]
    extended[0, POSITION] += step
    state = np.vstack([last.state[1:], extended])
    force = np.concatenate([last.force[1:-1], last.force[-3:-2]])
    footing = footing_of(gait)
    toes = np.concatenate([last.toes[1:], last.toes[-1:] + step])
    spots = toes[np.minimum(footing.first, len(toes) - 1), footing.leg, :2]
    return gait, Iterate(state, force, spots)


def motion_of(last: WalkTrajectory) -> Iterate:
    """A plan as a point to linearise about."""
    footing = footing_of(last.gait)
    return Iterate(last.state, last.force[:-1], last.toes[footing.first, footing.leg, :2])


def flat_gait(contact: Flags) -> Gait:
    """A gait on flat ground."""
    return Gait(np.array(contact, bool), np.zeros(contact.shape, np.int64))
