"""Solve the force problems of robots with grippers, and believe no solver.

DAQP on what equilibrium leaves free, cones as inscribed pyramids; what it cannot answer, or answers
beyond the exact constraints, is left to Clarabel on the exact cones.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import daqp
import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.grips.program import (
    SIZE,
    GripInstant,
    conic_program,
    friction_rows,
    grip_instant,
    linear_rows,
    open_fingers,
)
from climbplan.climb.forces.grips.statement import RESIDUAL_LIMIT, GripStatement

# Among forces of equal worst torque those of least squares are preferred, which makes answers
# unique; the weight is small against s, so that it costs little of the optimum.
PREFERENCE = 1e-4
_DEFINITE = 1e-8
_RANK_TOLERANCE = 1e-9
_UNBOUNDED = -1e30
_PRIMAL_TOLERANCE = 1e-10
_SOLVED = 1

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SolvedGrips:
    """Forces on palms and fingers that passed the check, and instants that have none."""

    parts: Array  # (K, N, 3, 3) by part [N], zero for lifted limbs
    missing: IntArray  # instants
    solved_again: int  # instants left to Clarabel


def solve_grips(statement: GripStatement, solver: str, facets: int) -> SolvedGrips:
    """Solve and check all instants; solver "clarabel" uses exact cones from the start."""
    count, limbs = statement.contact.shape
    parts = np.zeros((count, limbs, 3, 3))
    missing, again = [], 0
    for k in range(count):
        instant = grip_instant(statement, k)
        if instant.contacts == 0:
            if statement.load[k].any():
                missing.append(k)
            continue
        x = _by_daqp(instant, facets) if solver != "clarabel" else None
        if x is None or residual(instant, x) > RESIDUAL_LIMIT:
            again += 1
            x = by_clarabel(instant)
        if x is None:
            missing.append(k)
            continue
        parts[k, instant.limb] = statement.unit * x.reshape(-1, 3, 3)
    if again and solver != "clarabel":
        _log.info("%d instants without an answer of DAQP, solved by Clarabel", again)
    return SolvedGrips(parts, np.array(missing, np.int64), again)


def _by_daqp(instant: GripInstant, facets: int) -> Array | None:
    """Forces x (9 n,), or None without an optimum."""
    equal, right = instant.grasp, -instant.load
    if not instant.closed:
        opened = open_fingers(instant)
        equal = np.vstack([equal, opened])
        right = np.concatenate([right, np.zeros(len(opened))])
    left, sigma, rows = np.linalg.svd(equal, full_matrices=True)
    rank = int((sigma > _RANK_TOLERANCE * sigma[0]).sum())
    along = left.T @ right
    if np.abs(along[rank:]).max(initial=0.0) > RESIDUAL_LIMIT:
        return None
    particular = rows[:rank].T @ (along[:rank] / sigma[:rank])
    null_space = rows[rank:].T
    linear, friction = linear_rows(instant), friction_rows(instant, facets)
    A = np.concatenate([linear.A, friction.A])
    by_s = np.concatenate([linear.by_s, friction.by_s])
    upper = np.concatenate([linear.upper, friction.upper]) - A @ particular
    matrix = np.column_stack([-by_s, A @ null_space])
    size = null_space.shape[1] + 1
    hessian = PREFERENCE * np.eye(size)
    hessian[0, 0] = _DEFINITE
    gradient = np.concatenate([[1.0], PREFERENCE * null_space.T @ particular])
    bounds = np.concatenate([[instant.largest_s], upper])
    lower = np.full(len(bounds), _UNBOUNDED)
    lower[0] = 0.0
    answer, _, flag, _ = daqp.solve(
        hessian,
        gradient,
        np.ascontiguousarray(matrix),
        bounds,
        lower,
        np.zeros(len(bounds), np.int32),
        primal_tol=_PRIMAL_TOLERANCE,
    )
    if flag != _SOLVED:
        return None
    return np.asarray(particular + null_space @ np.asarray(answer)[1:])


def by_clarabel(instant: GripInstant) -> Array | None:
    """Forces x (9 n,) on the exact cones that pass the check, or None without any."""
    program = conic_program(instant)
    cost = np.zeros(program.size)
    cost[instant.size] = 1.0
    answer = program.minimise(cost)
    if answer is None:
        return None
    x = answer.x[: instant.size]
    return x if residual(instant, x) <= RESIDUAL_LIMIT else None


def residual(instant: GripInstant, x: Array) -> float:
    """Largest violation of the exact constraints by forces x (9 n,), in units of the load."""
    rows = linear_rows(instant)
    worst = [np.abs(instant.grasp @ x + instant.load).max()]
    worst.append((rows.A @ x - rows.by_s * instant.largest_s - rows.upper).max())
    if not instant.closed:
        worst.append(np.abs(open_fingers(instant) @ x).max())
    parts = x.reshape(-1, SIZE // 3, 3)
    local = np.einsum("npij,npj->npi", instant.axes, parts)
    further = local - instant.pulled
    for state, safety in ((local, instant.safety_friction), (further, 1.0)):
        held = instant.mu[:, None] * np.maximum(state[..., 0], 0.0) + instant.spines
        worst.append((np.hypot(state[..., 1], state[..., 2]) - held / safety).max())
    return float(max(*worst, 0.0))
