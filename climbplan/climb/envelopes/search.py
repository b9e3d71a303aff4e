"""Whether one posture exists on given patches: a point of problem P, or a proof that there is none.

Branch and bound over parts of the patches. A node whose relaxation (`relaxation`) is infeasible
holds no posture; otherwise toes are put on the centres of pressure, and with toes or with forces
given, P is linear: the two are alternated, and IPOPT is started from there. If that finds none, the
patch with the largest torsion is halved.

Algorithm numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.climb.envelopes.relaxation import Relaxed, solve_relaxed
from climbplan.climb.envelopes.statement import PostureStatement
from climbplan.climb.envelopes.terrains import LimbPatches
from climbplan.program.instance import Instance
from climbplan.reformulations.extension import create_no_implications
from climbplan.solvers.highs.linear import LinearProgram, solve_linear
from climbplan.solvers.ipopt.instances import solve_ipopt

TOLERANCE = 1e-7  # of constraints at a point that counts as feasible
_ROUNDS = 6  # of the alternation
_NODES = 2000
_LOCAL_EVERY = 16  # nodes
_LOCAL_TIME = 2.0  # [s]


@dataclass(frozen=True)
class PostureAnswer:
    """What is known about one terrain."""

    status: Literal["feasible", "infeasible", "limit"]
    x: Array | None  # a point of the statement
    nodes: int


def find_posture(
    statement: PostureStatement,
    patches: LimbPatches,
    load: Array | None = None,
    nodes: int = _NODES,
) -> PostureAnswer:
    """Return a point that satisfies P to 1e-7, or the proof that P has none on these patches."""
    theta = statement.theta(patches, load)
    instance = statement.program.instantiate(theta)
    force, moment = theta["force"], theta["moment"]
    open_nodes = [patches.vertices / statement.legs.length]
    count = 0
    while open_nodes and count < nodes:
        corners = open_nodes.pop(0)
        count += 1
        relaxed = solve_relaxed(statement.legs, patches, force, moment, corners)
        if relaxed is None:
            continue
        x = _alternate(statement, instance, relaxed)
        if x is None and (count - 1) % _LOCAL_EVERY == 0:
            x = _search_locally(statement, instance, relaxed)
        if x is not None:
            return PostureAnswer("feasible", x, count)
        limb = int(np.argmax(relaxed.torsion))
        open_nodes += [_bisect_patch(corners, limb, side) for side in (0, 1)]
    return PostureAnswer("limit" if open_nodes else "infeasible", None, count)


def drop_products(instance: Instance) -> Instance:
    """Return the instance without its bilinear rows: P-bar of Algorithm 1."""
    keep = np.diff(instance.Q.indptr) == 0
    none = np.zeros(0, np.int64)
    return replace(
        instance,
        A=sparse.csr_matrix(instance.A[keep]),
        row_lower=instance.row_lower[keep],
        row_upper=instance.row_upper[keep],
        products=replace(instance.products, first=none, second=none),
        Q=sparse.csr_matrix((int(keep.sum()), 0)),
    )


def _build_start(statement: PostureStatement, instance: Instance, relaxed: Relaxed) -> Array:
    x = np.zeros(instance.size)
    for name, block_value in (
        ("toe", relaxed.pressure),
        ("force", relaxed.force),
        ("com", relaxed.com),
        ("rpy", relaxed.rpy),
    ):
        block = statement.program.variables[name]
        x[block.start : block.stop] = block_value.ravel()
    return x


def _search_locally(
    statement: PostureStatement, instance: Instance, relaxed: Relaxed
) -> Array | None:
    solution = solve_ipopt(
        instance, start=_build_start(statement, instance, relaxed), time_limit=_LOCAL_TIME
    )
    return solution.x


def _bisect_patch(corners: Array, limb: int, side: int) -> Array:
    """Return one half of a limb's patch, cut across its longer edge."""
    a, b, c, d = corners[limb]
    if np.linalg.norm(b - a) >= np.linalg.norm(d - a):
        m, n = (a + b) / 2, (c + d) / 2
        half = [a, m, n, d] if side == 0 else [m, b, c, n]
    else:
        m, n = (a + d) / 2, (b + c) / 2
        half = [a, b, n, m] if side == 0 else [m, n, c, d]
    out = corners.copy()
    out[limb] = half
    return out


def _alternate(statement: PostureStatement, instance: Instance, relaxed: Relaxed) -> Array | None:
    """Alternate linear programs: forces at fixed toes, then toes at fixed forces, least moment
    error.
    """
    program = statement.program
    toe, f = program.variables["toe"], program.variables["force"]
    x = _build_start(statement, instance, relaxed)
    fixed_columns = np.arange(toe.start, toe.stop)
    last = np.inf
    for k in range(_ROUNDS):
        point_and_error = minimise_product_error(instance, x, fixed_columns)
        if point_and_error is None:
            return None
        x, error = point_and_error
        if error <= TOLERANCE / 10 and instance.violation(x) <= TOLERANCE:
            return x
        if k and error > 0.9 * last:
            return None
        last = error
        fixed_columns = np.arange(f.start, f.stop) if k % 2 == 0 else np.arange(toe.start, toe.stop)
    return None


def minimise_product_error(
    instance: Instance, x: Array, fixed_columns: IntArray
) -> tuple[Array, float] | None:
    """Return the point that keeps x[held] and misses the rows with products least, with the miss
    (1-norm).

    x[held] is one factor of every product, so that the problem is linear. None if no point
    satisfies the other rows.
    """
    fixed = fix_factors(instance, x, fixed_columns)
    bilinear = np.flatnonzero(np.diff(instance.Q.indptr))
    k, n = len(bilinear), instance.size
    slack = sparse.csr_matrix(
        (np.ones(k), (bilinear, np.arange(k))), shape=(instance.A.shape[0], k)
    )
    answer = solve_linear(
        LinearProgram(
            np.concatenate([np.zeros(n), np.ones(2 * k)]),
            np.concatenate([fixed.lower, np.zeros(2 * k)]),
            np.concatenate([fixed.upper, np.full(2 * k, np.inf)]),
            sparse.hstack([fixed.A, slack, -slack]).tocsr(),
            fixed.row_lower,
            fixed.row_upper,
        )
    )
    return None if answer.x is None else (answer.x[:n], answer.objective)


def fix_factors(instance: Instance, x: Array, fixed_columns: IntArray) -> Instance:
    """Return the instance with x[held] given, which makes every product linear in its other factor.

    The instance has no implications.
    """
    is_fixed = np.zeros(instance.size, bool)
    is_fixed[fixed_columns] = True
    first, second = instance.products.first, instance.products.second
    # Where both are given, the second counts as free: its bounds hold it
    swap = ~is_fixed[first]
    value = np.where(swap, x[second], x[first])
    column = np.where(swap, first, second)
    K = instance.products.count
    spread = sparse.csr_matrix((value, (np.arange(K), column)), shape=(K, instance.size))
    lower, upper = instance.lower.copy(), instance.upper.copy()
    lower[fixed_columns] = upper[fixed_columns] = x[fixed_columns]
    none = np.zeros(0, np.int64)
    return replace(
        instance,
        lower=lower,
        upper=upper,
        A=sparse.csr_matrix(instance.A + instance.Q @ spread),
        products=replace(instance.products, first=none, second=none),
        Q=sparse.csr_matrix((instance.A.shape[0], 0)),
        implications=create_no_implications(instance.size, 0),
    )
