"""Validation of plans by rollout of their forces in continuous time, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.kernels.body import integrate_rk4
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.parameters import GaitHorizon, LinearisationPoint, ToePlacement
from climbplan.walking.kernels.toe_workspace import (
    compute_reach_violation,
    compute_stance_violation,
    place_toes,
)
from climbplan.walking.task.task import BodyParameters, ToeWorkspace


@compiled
def roll_out_horizon(
    body: BodyParameters,
    horizon: GaitHorizon,
    workspace: ToeWorkspace,
    num_substeps: int,
    toes: Array,
    force: Array,
) -> tuple[Array, float]:
    """Roll out forces in continuous time, and watch standing toes between knots.

    A rolling body may move toes out of their boxes and back between two knots.

    Args:
        body: mass properties.
        horizon: intervals, contacts and first state.
        workspace: boxes of the toes.
        num_substeps: Runge-Kutta steps of each interval.
        toes: (>= N, L, 3) world frame [m].
        force: (N, L, 3) world frame [N].

    Returns:
        States (N + 1, 12) at knots, and the largest workspace violation of standing toes between
        knots, or 0 [m].
    """
    steps, start, contact = horizon.steps, horizon.start, horizon.contact
    states = np.empty((force.shape[0] + 1, 12))
    for k in range(12):
        states[0, k] = start[k]
    worst, once = 0.0, int(np.int64(1))  # a literal would be another type to compile for
    for n in range(force.shape[0]):
        state = states[n]
        for substep in range(num_substeps):
            state = integrate_rk4(body, steps[n] / num_substeps, once, state, toes[n], force[n])
            if substep < num_substeps - 1:
                violation = compute_stance_violation(workspace, state, toes[n], contact[n])
                worst = max(worst, violation)
        for k in range(12):
            states[n + 1, k] = state[k]
    return states, worst


@compiled
def validate_by_rollout(
    body: BodyParameters,
    horizon: GaitHorizon,
    placement: ToePlacement,
    plan: LinearisationPoint,
    num_substeps: int,
) -> tuple[Array, Array, float, float, float, float]:
    """Compare the rollout of a plan's forces with the states that a QP predicts.

    Args:
        body: mass properties.
        horizon: intervals, contacts and first state.
        placement: decides where toes are.
        plan: predicted states, forces and free footholds.
        num_substeps: Runge-Kutta steps of each interval.

    Returns:
        States (N + 1, 12) and toes (N + 1, L, 3) of the rollout; its largest deviations from the
        prediction in velocity [m/s] and angle [rad]; workspace violations at knots and, of standing
        toes, between knots [m]. All four figures are infinite where the rollout diverges.
    """
    workspace, predicted = placement.workspace, plan.state
    toes = place_toes(placement, predicted, plan.spots)
    states, between = roll_out_horizon(body, horizon, workspace, num_substeps, toes, plan.force)
    speed, angle = 0.0, 0.0
    for n in range(states.shape[0]):
        for k in range(12):
            if not np.isfinite(states[n, k]):
                return states, toes, np.inf, np.inf, np.inf, np.inf
        for k in range(3):
            speed = max(speed, abs(states[n, 3 + k] - predicted[n, 3 + k]))
            angle = max(angle, abs(states[n, 6 + k] - predicted[n, 6 + k]))
    toes = place_toes(placement, states, plan.spots)
    workspace_over_stance, contact = horizon.workspace_over_stance, horizon.contact
    reach = compute_reach_violation(workspace, workspace_over_stance, contact, states, toes)
    return states, toes, speed, angle, reach, between
