"""Solve the force problems of all instants, and check every answer.

Answers come from the reduced problems, solved again with the lazy constraints that they violate
(`lazy_constraints`). They are checked against the exact constraints. Instants that fail are solved
by Clarabel on the exact cones.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.forces.clarabel import solve_clarabel
from climbplan.climb.forces.daqp import solve_daqp
from climbplan.climb.forces.lazy_constraints import LazyConstraints, build_stability_cone
from climbplan.climb.forces.pyramids import solve_pyramids
from climbplan.climb.forces.reduction import ForceReduction, ReducedForces, reduce_forces
from climbplan.climb.forces.statement import RESIDUAL_LIMIT, ForceStatement, check_forces
from climbplan.errors import UsageError

_MAX_CUT_ROUNDS = 8  # times an instant is solved again with new restrictions
_LARGEST_FORCE = 1e9  # [N] what exceeds it is no answer

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Answers:
    """Forces of a group, with the solver's own verdict."""

    force: Array  # (B, n, 3) [N]
    solved: BoolArray  # (B,) what the solver says of itself


GroupSolver = Callable[[ReducedForces, int], _Answers]


def _solve_by_daqp(group: ReducedForces, facets: int) -> _Answers:
    """Solve a group on pyramids by DAQP."""
    optima = solve_pyramids(group, facets, solve_daqp)
    return _Answers(group.compute_forces(optima.x[:, 1:]), optima.solved)


def _solve_by_osqp(group: ReducedForces, facets: int) -> _Answers:
    """Solve a group on pyramids by OSQP."""
    from climbplan.climb.forces.osqp import solve_osqp

    optima = solve_pyramids(group, facets, solve_osqp)
    return _Answers(group.compute_forces(optima.x[:, 1:]), optima.solved)


def _solve_by_clarabel(group: ReducedForces, facets: int) -> _Answers:
    """Solve a group on the exact cones by Clarabel."""
    optima = solve_clarabel(group)
    return _Answers(group.compute_forces(optima.x[:, 1:]), optima.solved)


SOLVERS: dict[str, GroupSolver] = {
    "daqp": _solve_by_daqp,
    "clarabel": _solve_by_clarabel,
    "osqp": _solve_by_osqp,
}


@dataclass(frozen=True)
class SolvedForces:
    """Answers of the force problems that passed the check, and the instants that have none."""

    force: Array  # (K, N, 3) [N]
    missing: IntArray  # instants for which no solver has an answer that holds
    unbalanced: IntArray  # instants whose contacts cannot balance the load at all
    num_resolved: int  # instants left to Clarabel by another solver


def solve_forces(
    statement: ForceStatement, solver: str, facets: int, is_quick: bool = False
) -> SolvedForces:
    """Solve and check the force problems of all instants.

    Args:
        statement: The force problems.
        solver: "daqp", "clarabel" or "osqp".
        facets: Number of sides of the friction pyramids; without effect for "clarabel".
        is_quick: Whether instants that the solver cannot decide count as missing; otherwise
            Clarabel solves them on the exact cones.
    """
    if solver not in SOLVERS:
        raise UsageError(f"unknown force solver {solver!r}: expected one of {', '.join(SOLVERS)}")
    reduction = reduce_forces(statement)
    force = np.zeros(statement.arms.shape)
    solved = np.ones(len(force), bool)
    for group in reduction.groups:
        _store_answers(group, SOLVERS[solver](group, facets), force, solved)
    constraints = LazyConstraints(statement)
    violating = constraints.find_violations(force)
    for _ in range(_MAX_CUT_ROUNDS):
        violating = violating[solved[violating]]
        if not len(violating):
            break
        _solve_constrained(
            reduction, constraints, violating, solver, facets=facets, force=force, solved=solved
        )
        violating = np.intersect1d(violating, constraints.find_violations(force))
    is_accepted = solved & (check_forces(statement, force).worst <= RESIDUAL_LIMIT)
    is_accepted[reduction.unbalanced] = True  # nothing to solve
    unsolved = np.flatnonzero(~is_accepted)
    if len(unsolved) and not is_quick:
        _log.info("%d instants without an answer of %s, solved by Clarabel", len(unsolved), solver)
        constraints.reserve = 0.0  # a motion that needs it will say so
        _solve_constrained(
            reduction, constraints, unsolved, "clarabel", facets=facets, force=force, solved=solved
        )
        is_accepted = solved & (check_forces(statement, force).worst <= RESIDUAL_LIMIT)
        is_accepted[reduction.unbalanced] = True
    missing = np.flatnonzero(~is_accepted)
    return SolvedForces(force, missing, reduction.unbalanced, len(unsolved))


def _solve_constrained(
    reduction: ForceReduction,
    constraints: LazyConstraints,
    instants: IntArray,
    solver: str,
    *,
    facets: int,
    force: Array,
    solved: BoolArray,
) -> None:
    """Solve some instants again, with all lazy constraints found so far, in place."""
    for group in reduction.groups:
        rows_in_group = np.flatnonzero(np.isin(group.instant, instants))
        if len(rows_in_group):
            subgroup = group.take(rows_in_group)
            rows = constraints.build_command_rows(subgroup.instant).append_rows(
                constraints.build_penetration_rows(subgroup.instant)
            )
            A, upper = rows.select_limbs(subgroup.limb), rows.upper
            if solver == "clarabel":
                rows = build_stability_cone(constraints.statement, subgroup.instant)
                subgroup = subgroup.with_stability(rows.select_limbs(subgroup.limb), rows.upper)
            else:
                rows = constraints.collect_cuts(subgroup.instant)
                A = np.concatenate([A, rows.select_limbs(subgroup.limb)], axis=1)
                upper = np.concatenate([upper, rows.upper], axis=1)
            subgroup = subgroup.with_rows(A, upper)
            _store_answers(subgroup, SOLVERS[solver](subgroup, facets), force, solved)


def _store_answers(
    group: ReducedForces, answers: _Answers, force: Array, solved: BoolArray
) -> None:
    """Write the answers of a group into the arrays of all instants.

    A solver that gives up may leave anything in its variables, numbers that are not finite
    included; instants that it has not solved are stored with zero forces.
    """
    is_solved = answers.solved & (np.abs(answers.force) < _LARGEST_FORCE).all(axis=(1, 2))
    answer = np.where(is_solved[:, None, None], answers.force, 0.0)
    force[group.instant[:, None], group.limb] = answer
    solved[group.instant] = is_solved
