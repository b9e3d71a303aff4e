"""Toe positions and violations of their workspace boxes, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.parameters import ToePlacement
from climbplan.walking.task.task import ToeWorkspace


@compiled
def _place_swing_toe(center: Array, half: Array, R: Array, position: Array, height: float) -> Array:
    """Return a swinging toe (3,) at a given height, near the middle of its box.

    Under a tilted body the middle may be too high or too low in the body. The toe then moves
    towards the corner where its height in the body is smallest or largest, as far as necessary.
    """
    down, rise = R[2, 2], height - position[2]
    reach_x, reach_y = half[0] * np.sign(R[2, 0]), half[1] * np.sign(R[2, 1])
    level = (rise - R[2, 0] * center[0] - R[2, 1] * center[1]) / down
    change = (R[2, 0] * reach_x + R[2, 1] * reach_y) / down
    lowest, highest = level - change, level + change
    ceiling, floor = center[2] + half[2], center[2] - half[2]
    to_lower = min(max((level - ceiling) / max(level - lowest, 1e-9), 0.0), 1.0)
    to_higher = min(max((floor - level) / max(highest - level, 1e-9), 0.0), 1.0)
    spot = np.empty(3)
    spot[0] = center[0] + (to_lower - to_higher) * reach_x
    spot[1] = center[1] + (to_lower - to_higher) * reach_y
    spot[2] = (rise - R[2, 0] * spot[0] - R[2, 1] * spot[1]) / down
    toe = np.empty(3)
    for i in range(3):
        toe[i] = position[i] + R[i, 0] * spot[0] + R[i, 1] * spot[1] + R[i, 2] * spot[2]
    return toe


@compiled
def place_toes(placement: ToePlacement, state: Array, spots: Array) -> Array:
    """Place all toes: standing ones at their footholds, swinging ones under the body.

    Args:
        placement: footholds by knot, heights and workspace boxes.
        state: (N + 1, 12) states.
        spots: (F, 2) free footholds [m].

    Returns:
        Toes (N + 1, L, 3), world frame [m].
    """
    center, half = placement.workspace.center, placement.workspace.half
    foothold, height, start = placement.foothold, placement.height, placement.start
    base, tilt = placement.base, placement.tilt
    knots, legs = foothold.shape
    toes, R = np.empty((knots, legs, 3)), np.empty((3, 3))
    for n in range(knots):
        rotation(state[n, 6:9], R)
        for leg in range(legs):
            index = foothold[n, leg]
            if n == 0 or index == -1:
                for k in range(3):
                    toes[n, leg, k] = start[leg, k]
            elif index >= 0:
                toes[n, leg, 0], toes[n, leg, 1] = spots[index, 0], spots[index, 1]
                toes[n, leg, 2] = base[index]
                for k in range(2):
                    toes[n, leg, 2] += tilt[index, k] * spots[index, k]
            else:
                toe = _place_swing_toe(center[leg], half, R, state[n], height[n, leg])
                for k in range(3):
                    toes[n, leg, k] = toe[k]
    return toes


@compiled
def compute_box_violation(center: Array, half: Array, R: Array, state: Array, toe: Array) -> float:
    """Return how far a toe (3,) is outside its box [m], negative inside; R: of the state (12,)."""
    worst = -np.inf
    for i in range(3):
        in_body = 0.0
        for j in range(3):
            in_body += R[j, i] * (toe[j] - state[j])
        worst = max(worst, abs(in_body - center[i]) - half[i])
    return worst


@compiled
def compute_reach_violation(
    workspace: ToeWorkspace,
    workspace_over_stance: bool,
    contact: BoolArray,
    state: Array,
    toes: Array,
) -> float:
    """Return the largest workspace violation at knots, at knot 0 of standing toes only.

    Args:
        workspace: boxes of the toes.
        workspace_over_stance: count standing toes also at the end of their interval.
        contact: (N + 1, L).
        state: (N + 1, 12).
        toes: (N + 1, L, 3) world frame [m].

    Returns:
        The violation [m], negative where all toes are inside.
    """
    center, half = workspace.center, workspace.half
    worst, R = -np.inf, np.empty((3, 3))
    for n in range(state.shape[0]):
        rotation(state[n, 6:9], R)
        for leg in range(center.shape[0]):
            if n > 0 or contact[n, leg]:
                worst = max(
                    worst, compute_box_violation(center[leg], half, R, state[n], toes[n, leg])
                )
            if workspace_over_stance and n > 0 and contact[n - 1, leg]:
                worst = max(
                    worst, compute_box_violation(center[leg], half, R, state[n], toes[n - 1, leg])
                )
    return worst


@compiled
def compute_stance_violation(
    workspace: ToeWorkspace, state: Array, toes: Array, contact: BoolArray
) -> float:
    """Return the largest workspace violation of standing toes (L, 3) in a state (12,), or 0 [m]."""
    center, half = workspace.center, workspace.half
    worst, R = 0.0, np.empty((3, 3))
    rotation(state[6:9], R)
    for leg in range(center.shape[0]):
        if contact[leg]:
            worst = max(worst, compute_box_violation(center[leg], half, R, state, toes[leg]))
    return worst


@compiled
def check_reach(
    workspace: ToeWorkspace, state: Array, toes: Array, tolerance: float, dt: float, margin: float
) -> BoolArray:
    """Check for each leg whether its toe is in reach, now and while the body moves on.

    Args:
        workspace: boxes of the toes.
        state: (12,) of the body.
        toes: (L, 3) world frame [m].
        tolerance: admissible violation now [m].
        dt: time in which the body moves on at its velocity; 0: not considered [s].
        margin: admissible violation after that time [m].

    Returns:
        Mask (L,).
    """
    center, half = workspace.center, workspace.half
    legs, R = center.shape[0], np.empty((3, 3))
    within, later = np.empty(legs, np.bool_), state.copy()
    rotation(state[6:9], R)
    for k in range(3):
        later[k] += dt * state[3 + k]
    for leg in range(legs):
        within[leg] = compute_box_violation(center[leg], half, R, state, toes[leg]) <= tolerance
        if within[leg] and dt > 0.0:
            within[leg] = compute_box_violation(center[leg], half, R, later, toes[leg]) <= margin
    return within
