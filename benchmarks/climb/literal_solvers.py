"""Solve the literal force problem by Clarabel and by CVXPY: oracles and alternatives."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.forces.clarabel import build_clarabel_settings
from climbplan.climb.forces.unreduced import UnreducedProblem
from climbplan.errors import MissingSolver
from climbplan.mechanics.friction import contact_frame


@dataclass(frozen=True)
class LiteralAnswer:
    """Optimum of one instant."""

    force: Array  # (N, 3) [N]
    wall_deflection: Array  # (N, 3) [m]
    com_deflection: Array  # (6,) [m, rad]
    s: float


def solve_literal(problem: UnreducedProblem) -> LiteralAnswer | None:
    """The literal form by Clarabel's native interface; None if it finds no optimum."""
    n = len(problem.normal)
    f, wall, tau, s = 6, 6 + 3 * n, 6 + 6 * n, 6 + 9 * n
    size = 7 + 9 * n
    K = _block_diagonal(problem.stiffness)
    B = problem.motion.reshape(3 * n, 6)
    one = np.eye(3 * n)

    def rows(count: int, *parts: tuple[int, Array]) -> Array:
        out = np.zeros((count, size))
        for column, part in parts:
            out[:, column : column + part.shape[1]] = part
        return out

    J_T = _block_diagonal(np.swapaxes(problem.jacobian, -1, -2))
    limit = problem.max_torque.reshape(3 * n, 1)
    air = np.repeat(~problem.contact, 3)
    normal = np.zeros((n, 3 * n))
    for i in range(n):
        normal[i, 3 * i : 3 * i + 3] = problem.normal[i]
    frame = contact_frame(problem.normal)
    cone = np.zeros((n, 3, 3 * n))
    for i in range(n):
        cone[i, 0] = problem.usable_mu[i] * normal[i]
        cone[i, 1, 3 * i : 3 * i + 3] = frame.tangent[i]
        cone[i, 2, 3 * i : 3 * i + 3] = frame.bitangent[i]
    blocks = [
        rows(6, (0, problem.body_stiffness), (wall, -B.T @ K)),  # eq. (4.17)
        rows(3 * n, (f, one), (wall, -K), (0, K @ B)),  # eq. (4.14)
        rows(3 * n, (tau, one), (f, -J_T)),  # torques
        rows(int(air.sum()), (wall, one[air])),  # no wall, no deflection
        rows(3 * n, (tau, one), (s, -limit)),
        rows(3 * n, (tau, -one), (s, -limit)),
        rows(n, (f, -normal)),
        rows(2, (s, np.array([[1.0], [-1.0]]))),
        rows(3 * n, (f, -cone.reshape(3 * n, 3 * n))),
    ]
    b = np.zeros(sum(len(block) for block in blocks))
    b[:6] = problem.load
    equal = sum(len(block) for block in blocks[:4])
    inequal = sum(len(block) for block in blocks[4:8])
    b[equal + inequal - 2] = problem.max_s
    cost = np.zeros(size)
    cost[s] = 1.0
    cost[f:wall] = -problem.weight * (problem.normal * problem.contact[:, None]).ravel()
    cones = [
        clarabel.ZeroConeT(equal),
        clarabel.NonnegativeConeT(inequal),
        *[clarabel.SecondOrderConeT(3)] * n,
    ]
    P = sparse.csc_matrix((size, size))
    A = sparse.csc_matrix(np.vstack(blocks))
    solution = clarabel.DefaultSolver(P, cost, A, b, cones, build_clarabel_settings()).solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    x = np.array(solution.x)
    return LiteralAnswer(x[f:wall].reshape(n, 3), x[wall:tau].reshape(n, 3), x[:6], float(x[s]))


def solve_cvxpy(problem: UnreducedProblem) -> LiteralAnswer | None:
    """The same form written in CVXPY; None if its solver finds no optimum.

    Raises MissingSolver if CVXPY, an optional dependency, is not installed.
    """
    cp = _cvxpy()
    n = len(problem.normal)
    com, s = cp.Variable(6), cp.Variable()
    f, wall, tau = cp.Variable((n, 3)), cp.Variable((n, 3)), cp.Variable((n, 3))
    constraints = [s >= 0, s <= problem.max_s]
    pushed: Any = 0
    for i in range(n):
        K, B, normal = problem.stiffness[i], problem.motion[i], problem.normal[i]
        pushed = pushed + B.T @ K @ wall[i]
        pressure = normal @ f[i]
        constraints += [
            f[i] == K @ (wall[i] - B @ com),
            tau[i] == problem.jacobian[i].T @ f[i],
            cp.abs(tau[i]) <= s * problem.max_torque[i],
            pressure >= 0,
            cp.norm(f[i] - pressure * normal) <= problem.usable_mu[i] * pressure,
        ]
        if not problem.contact[i]:
            constraints.append(wall[i] == 0)
    constraints.append(problem.body_stiffness @ com == problem.load + pushed)
    pressures = cp.sum(cp.multiply(problem.normal * problem.contact[:, None], f))
    program = cp.Problem(cp.Minimize(s - problem.weight * pressures), constraints)
    program.solve(solver=cp.CLARABEL)
    if program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        return None
    return LiteralAnswer(f.value, wall.value, com.value, float(s.value))


def _cvxpy() -> Any:
    try:
        return import_module("cvxpy")
    except ImportError as error:
        raise MissingSolver(
            "CVXPY is not installed: pip install 'climbplan[bench]' for comparisons with it"
        ) from error


def _block_diagonal(blocks: Array) -> Array:
    """(n, 3, 3) to (3 n, 3 n)."""
    n = len(blocks)
    out = np.zeros((n, 3, n, 3))
    out[np.arange(n), :, np.arange(n)] = blocks
    return out.reshape(3 * n, 3 * n)
