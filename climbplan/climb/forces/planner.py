"""The force planner: contact forces and commands at every instant (chapter 5.1.4).

One convex problem an instant (`statement`), reduced to the forces that equilibrium leaves
free (`reduction`), solved on inscribed pyramids or exact cones, checked against the exact
constraints, and only then turned into commanded toe positions (`commands`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.climb.forces.clarabel import solve_clarabel
from climbplan.climb.forces.commands import press
from climbplan.climb.forces.daqp import solve_daqp
from climbplan.climb.forces.explanation import explain
from climbplan.climb.forces.osqp import solve_osqp
from climbplan.climb.forces.pyramids import solve_pyramids
from climbplan.climb.forces.reach import Pressing
from climbplan.climb.forces.reduction import ReducedForces, reduce_forces
from climbplan.climb.forces.statement import (
    RESIDUAL_LIMIT,
    ForceStatement,
    check_forces,
    state_forces,
    torques_of,
)
from climbplan.climb.scene import ClimbScene
from climbplan.errors import UsageError
from climbplan.mechanics.friction import critical_friction
from climbplan.plans.climb_plan import Array, Forces, Index, Instants, Mask

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Answers:
    force: Array  # (B, n, 3) [N]
    solved: Mask  # (B,) what the solver says of itself


GroupSolver = Callable[[ReducedForces, int], _Answers]


def _by_daqp(group: ReducedForces, facets: int) -> _Answers:
    optima = solve_pyramids(group, facets, solve_daqp)
    return _Answers(group.forces(optima.x[:, 1:]), optima.solved)


def _by_osqp(group: ReducedForces, facets: int) -> _Answers:
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
    missing: Index  # instants for which no solver has an answer that holds
    unbalanced: Index  # instants whose contacts cannot balance the load at all
    solved_again: int  # instants left to Clarabel by another solver


def plan_forces(scene: ClimbScene, instants: Instants, solver: str | None = None) -> Forces:
    """Contact forces, torques and commands of all instants.

    solver: "daqp", "clarabel" or "osqp", by default the spec's. Every answer is checked against
    the exact constraints; one that fails, or for which an inscribed pyramid has no room, is solved
    again by Clarabel on the exact cones. Raises Infeasible with the conflicting constraints of
    instants without admissible forces, and LimitReached if Clarabel cannot settle an instant.
    """
    statement = state_forces(scene, instants)
    name = solver or scene.spec.solver.force
    solved = solve_forces(statement, name, scene.spec.force.facets)
    if len(solved.missing) or len(solved.unbalanced):
        raise explain(scene, instants, statement, solved.missing, solved.unbalanced)
    return _assembled(instants, statement, press(scene, instants, statement, solved.force))


def solve_forces(statement: ForceStatement, solver: str, facets: int) -> SolvedForces:
    """Solve and check the force problems; facets: sides of the pyramids (not for "clarabel")."""
    if solver not in SOLVERS:
        raise UsageError(f"unknown force solver {solver!r}: expected one of {', '.join(SOLVERS)}")
    reduction = reduce_forces(statement)
    force = np.zeros(statement.arms.shape)
    solved = np.ones(len(force), bool)
    for group in reduction.groups:
        _enter(group, SOLVERS[solver](group, facets), force, solved)
    held = solved & (check_forces(statement, force).worst <= RESIDUAL_LIMIT)
    held[reduction.unbalanced] = True  # nothing to solve
    again = 0
    if solver != "clarabel" and not held.all():
        for group in reduction.groups:
            rows = np.flatnonzero(~held[group.instant])
            if len(rows):
                again += len(rows)
                part = group.take(rows)
                _enter(part, _by_clarabel(part, facets), force, solved)
        _log.info("%d instants without an answer of %s, solved by Clarabel", again, solver)
        held = solved & (check_forces(statement, force).worst <= RESIDUAL_LIMIT)
        held[reduction.unbalanced] = True
    return SolvedForces(force, np.flatnonzero(~held), reduction.unbalanced, again)


def _enter(group: ReducedForces, answers: _Answers, force: Array, solved: Mask) -> None:
    force[group.instant[:, None], group.limb] = answers.force
    solved[group.instant] = answers.solved


def _assembled(instants: Instants, statement: ForceStatement, pressing: Pressing) -> Forces:
    """Torques, commands and safety factors; factors are infinite where nothing is loaded."""
    force, deflections = pressing.force, pressing.deflections
    torques = torques_of(statement, force)
    use = (np.abs(torques) / statement.max_torque).max(axis=(1, 2))
    critical = critical_friction(force, statement.normal)
    ratio = np.full(critical.shape, np.inf)
    np.divide(statement.mu, critical, out=ratio, where=critical > 0)
    safety_torque = np.full(len(use), np.inf)
    np.divide(1.0, use, out=safety_torque, where=use > 0)
    return Forces(
        force=force,
        joint_torques=torques,
        wall_deflection=deflections.wall,
        com_deflection=deflections.com,
        toe_command=instants.toes - deflections.wall,
        safety_torque=safety_torque,
        safety_friction=ratio.min(axis=1),
        mu_critical=critical,
    )
