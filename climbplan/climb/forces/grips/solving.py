"""Solve the force problems of robots with grippers, and check every answer.

DAQP solves the problem on the null space of equilibrium, with cones as inscribed pyramids. Instants
without an answer that passes the exact check are solved by Clarabel on the exact cones.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import daqp
import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.grips.program import (
    LIMB_SIZE,
    GripInstant,
    build_conic_program,
    build_friction_rows,
    build_grip_instant,
    build_linear_rows,
    build_open_finger_rows,
)
from climbplan.climb.forces.grips.statement import RESIDUAL_LIMIT, GripStatement

# Among forces of equal worst torque those of least squares are preferred, which makes answers
# unique; the weight is small against s, so that it costs little of the optimum.
PREFERENCE = 1e-4
_REGULARISATION = 1e-8
_RANK_TOLERANCE = 1e-9
_UNBOUNDED = -1e30
_PRIMAL_TOLERANCE = 1e-10
_SOLVED = 1

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SolvedGrips:
    """Forces on palms and fingers that passed the check, and the instants that have none."""

    part_forces: Array  # (K, N, 3, 3) by part [N], zero for lifted limbs
    missing: IntArray  # instants
    num_resolved: int  # instants left to Clarabel


def solve_grips(statement: GripStatement, solver: str, facets: int) -> SolvedGrips:
    """Solve and check all instants; solver "clarabel" uses the exact cones from the start."""
    count, limbs = statement.contact.shape
    part_forces = np.zeros((count, limbs, 3, 3))
    missing, num_resolved = [], 0
    for k in range(count):
        instant = build_grip_instant(statement, k)
        if instant.num_contacts == 0:
            if statement.load[k].any():
                missing.append(k)
            continue
        x = _solve_by_daqp(instant, facets) if solver != "clarabel" else None
        if x is None or compute_residual(instant, x) > RESIDUAL_LIMIT:
            num_resolved += 1
            x = solve_by_clarabel(instant)
        if x is None:
            missing.append(k)
            continue
        part_forces[k, instant.limb] = statement.unit * x.reshape(-1, 3, 3)
    if num_resolved and solver != "clarabel":
        _log.info("%d instants without an answer of DAQP, solved by Clarabel", num_resolved)
    return SolvedGrips(part_forces, np.array(missing, np.int64), num_resolved)


def _solve_by_daqp(instant: GripInstant, facets: int) -> Array | None:
    """Return forces x (9 n,), or None without an optimum."""
    equality_rows, right_hand_side = instant.grasp, -instant.load
    if not instant.can_grip:
        finger_rows = build_open_finger_rows(instant)
        equality_rows = np.vstack([equality_rows, finger_rows])
        right_hand_side = np.concatenate([right_hand_side, np.zeros(len(finger_rows))])
    left_vectors, sigma, right_vectors = np.linalg.svd(equality_rows, full_matrices=True)
    rank = int((sigma > _RANK_TOLERANCE * sigma[0]).sum())
    projected_load = left_vectors.T @ right_hand_side
    if np.abs(projected_load[rank:]).max(initial=0.0) > RESIDUAL_LIMIT:
        return None
    particular = right_vectors[:rank].T @ (projected_load[:rank] / sigma[:rank])
    null_space = right_vectors[rank:].T
    linear, friction = build_linear_rows(instant), build_friction_rows(instant, facets)
    A = np.concatenate([linear.A, friction.A])
    by_s = np.concatenate([linear.s_coefficients, friction.s_coefficients])
    upper = np.concatenate([linear.upper, friction.upper]) - A @ particular
    matrix = np.column_stack([-by_s, A @ null_space])
    size = null_space.shape[1] + 1
    hessian = PREFERENCE * np.eye(size)
    hessian[0, 0] = _REGULARISATION
    gradient = np.concatenate([[1.0], PREFERENCE * null_space.T @ particular])
    bounds = np.concatenate([[instant.max_s], upper])
    lower = np.full(len(bounds), _UNBOUNDED)
    lower[0] = 0.0
    solution, _, flag, _ = daqp.solve(
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
    return np.asarray(particular + null_space @ np.asarray(solution)[1:])


def solve_by_clarabel(instant: GripInstant) -> Array | None:
    """Return forces x (9 n,) on the exact cones that pass the check, or None without any."""
    program = build_conic_program(instant)
    cost = np.zeros(program.size)
    cost[instant.size] = 1.0
    answer = program.minimise(cost)
    if answer is None:
        return None
    x = answer.x[: instant.size]
    return x if compute_residual(instant, x) <= RESIDUAL_LIMIT else None


def compute_residual(instant: GripInstant, x: Array) -> float:
    """Return the largest violation of the exact constraints by forces x (9 n,), in units of the
    load.
    """
    rows = build_linear_rows(instant)
    violations = [np.abs(instant.grasp @ x + instant.load).max()]
    violations.append((rows.A @ x - rows.s_coefficients * instant.max_s - rows.upper).max())
    if not instant.can_grip:
        violations.append(np.abs(build_open_finger_rows(instant) @ x).max())
    part_forces = x.reshape(-1, LIMB_SIZE // 3, 3)
    components = np.einsum("npij,npj->npi", instant.axes, part_forces)
    pulled_components = components - instant.pull_components
    for force_components, safety in (
        (components, instant.safety_friction),
        (pulled_components, 1.0),
    ):
        max_shear = instant.mu[:, None] * np.maximum(force_components[..., 0], 0.0) + instant.spines
        violations.append(
            (
                np.hypot(force_components[..., 1], force_components[..., 2]) - max_shear / safety
            ).max()
        )
    return float(max(*violations, 0.0))
