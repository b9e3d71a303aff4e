"""Adapts candidate gaits to the current tick: the shifted previous plan, and legs able to stand."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.walking.kernels.contact_phases import shift_horizon
from climbplan.walking.kernels.toe_workspace import check_reach
from climbplan.walking.offline.fixed_contact_qp import WalkIterate
from climbplan.walking.offline.footing import build_footing, build_gait
from climbplan.walking.online.gait_solver import REACH_TOLERANCE
from climbplan.walking.task.task import Gait, WalkTask, WalkTrajectory

_MAX_ACCELERATION = 8.0  # [m/s^2] that forces within friction can cause


def find_reachable_legs(task: WalkTask) -> BoolArray:
    """Return the legs (L,) whose toes are in reach, now and until the first interval ends.

    The end of the interval matters only where standing toes must stay in their boxes until then.
    """
    body, start = task.body, task.start
    dt = (task.first or task.dt) if task.workspace_over_stance else 0.0
    end_tolerance = REACH_TOLERANCE + 0.5 * _MAX_ACCELERATION * dt**2
    reached: BoolArray = check_reach(
        body.toe_workspace, start.state, start.toes, REACH_TOLERANCE, dt, end_tolerance
    )
    return reached


def restrict_gait(task: WalkTask, gait: Gait, available: BoolArray) -> Gait | None:
    """Return the gait without first contacts of unavailable legs.

    If too few of its legs are available, all available legs stand in the first interval, and no
    gait is rejected for that.

    Args:
        task: the walking task.
        gait: contacts and regions.
        available: (L,) legs that can stand in the first interval.
    """
    if not (gait.contact[0] & ~available).any():
        return gait
    contact = gait.contact.copy()
    contact[0] &= available
    if contact[0].sum() < task.min_contacts:
        contact[0] = available  # all available legs stand
    if contact[0].sum() < min(task.min_contacts, int(available.sum())):
        return None
    return build_gait(contact, gait.region)


def shift_plan(plan: WalkTrajectory) -> tuple[Gait, WalkIterate]:
    """Shift a plan by one knot (receding horizon) and extend its rhythm by one knot."""
    contact, state, force, spots = shift_horizon(
        plan.gait.contact, plan.state, plan.force, plan.toes
    )
    return build_flat_gait(contact), WalkIterate(state, force, spots)


def extract_iterate(plan: WalkTrajectory) -> WalkIterate:
    """Return a plan as a point of linearisation."""
    footing = build_footing(plan.gait)
    return WalkIterate(plan.state, plan.force[:-1], plan.toes[footing.first, footing.leg, :2])


def build_flat_gait(contact: BoolArray) -> Gait:
    """Return a gait of contacts (N + 1, L) on a single region."""
    return Gait(np.array(contact, bool), np.zeros(contact.shape, np.int64))
