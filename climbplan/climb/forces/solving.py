"""Solve the force problems of all instants, and believe no solver.

Answers come from the reduced problems, again with the restrictions that they break
(`restrictions`), and are checked against the exact constraints. What fails is left to Clarabel on
the exact cones.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.forces.clarabel import solve_clarabel
from climbplan.climb.forces.daqp import solve_daqp
from climbplan.climb.forces.pyramids import solve_pyramids
from climbplan.climb.forces.reduction import ReducedForces, Reduction, reduce_forces
from climbplan.climb.forces.restrictions import Restrictions, stability_cone
from climbplan.climb.forces.statement import RESIDUAL_LIMIT, ForceStatement, check_forces
from climbplan.errors import UsageError

_CUT_ROUNDS = 8  # times an instant is solved again with new restrictions

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Answers:
    force: Array  # (B, n, 3) [N]
    solved: BoolArray  # (B,) what the solver says of itself


GroupSolver = Callable[[ReducedForces, int], _Answers]


def _by_daqp(group: ReducedForces, facets: int) -> _Answers:
    optima = solve_pyramids(group, facets, solve_daqp)
    return _Answers(group.forces(optima.x[:, 1:]), optima.solved)


def _by_osqp(group: ReducedForces, facets: int) -> _Answers:
    from climbplan.climb.forces.osqp import solve_osqp

    optima = solve_pyramids(group, facets, solve_osqp)
    return _Answers(group.forces(optima.x[:, 1:]), optima.solved)


def _by_clarabel(group: ReducedForces, facets: int) -> _Answers:
    optima = solve_clarabel(group)
    return _Answers(group.forces(optima.x[:, 1:]), optima.solved)


SOLVERS: dict[str, GroupSolver] = {
    "daqp": _by_daqp,
    "clarabel": _by_clarabel,
    "osqp": _by_osqp,
}


@dataclass(frozen=True)
class SolvedForces:
    """Answers of the force problems that passed the check, and which have none."""

    force: Array  # (K, N, 3) [N]
    missing: IntArray  # instants for which no solver has an answer that holds
    unbalanced: IntArray  # instants whose contacts cannot balance the load at all
    solved_again: int  # instants left to Clarabel by another solver


def solve_forces(statement: ForceStatement, solver: str, facets: int) -> SolvedForces:
    """Solve and check the force problems; facets: sides of the pyramids (not for "clarabel")."""
    if solver not in SOLVERS:
        raise UsageError(f"unknown force solver {solver!r}: expected one of {', '.join(SOLVERS)}")
    reduction = reduce_forces(statement)
    force = np.zeros(statement.arms.shape)
    solved = np.ones(len(force), bool)
    for group in reduction.groups:
        _enter(group, SOLVERS[solver](group, facets), force, solved)
    restrictions = Restrictions(statement)
    broken = restrictions.broken_by(force)
    for _ in range(_CUT_ROUNDS):
        broken = broken[solved[broken]]
        if not len(broken):
            break
        _solve_restricted(reduction, restrictions, broken, solver, facets, force, solved)
        broken = np.intersect1d(broken, restrictions.broken_by(force))
    held = solved & (check_forces(statement, force).worst <= RESIDUAL_LIMIT)
    held[reduction.unbalanced] = True  # nothing to solve
    left = np.flatnonzero(~held)
    if len(left):
        _log.info("%d instants without an answer of %s, solved by Clarabel", len(left), solver)
        restrictions.reserve = 0.0  # a motion that needs it will say so
        _solve_restricted(reduction, restrictions, left, "clarabel", facets, force, solved)
        held = solved & (check_forces(statement, force).worst <= RESIDUAL_LIMIT)
        held[reduction.unbalanced] = True
    missing = np.flatnonzero(~held)
    return SolvedForces(force, missing, reduction.unbalanced, len(left))


def _solve_restricted(
    reduction: Reduction,
    restrictions: Restrictions,
    instants: IntArray,
    solver: str,
    facets: int,
    force: Array,
    solved: BoolArray,
) -> None:
    """Solve some instants again, with all restrictions found so far."""
    for group in reduction.groups:
        at = np.flatnonzero(np.isin(group.instant, instants))
        if len(at):
            part = group.take(at)
            rows = restrictions.commands(part.instant).and_also(restrictions.depths(part.instant))
            A, upper = rows.of_limbs(part.limb), rows.upper
            if solver == "clarabel":
                rows = stability_cone(restrictions.statement, part.instant)
                part = part.stabilised(rows.of_limbs(part.limb), rows.upper)
            else:
                rows = restrictions.cuts(part.instant)
                A = np.concatenate([A, rows.of_limbs(part.limb)], axis=1)
                upper = np.concatenate([upper, rows.upper], axis=1)
            part = part.restricted(A, upper)
            _enter(part, SOLVERS[solver](part, facets), force, solved)


def _enter(group: ReducedForces, answers: _Answers, force: Array, solved: BoolArray) -> None:
    force[group.instant[:, None], group.limb] = answers.force
    solved[group.instant] = answers.solved
