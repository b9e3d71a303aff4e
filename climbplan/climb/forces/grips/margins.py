"""Margins of grips: what they hold beyond what the plan needs of them.

At each instant every grip should hold an additional pull, and palms and fingers should stay where
friction and spines are weaker than assumed (`margins.pull`, `margins.slip` of a spec). Where this
is infeasible, the largest common fraction t of both is found by bisection, since feasibility is
monotone in t. Grips of smallest cost are then computed at nearly that fraction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.grips.program import build_grip_instant
from climbplan.climb.forces.grips.solving import SolvedGrips, solve_by_clarabel, solve_grips
from climbplan.climb.forces.grips.statement import GripStatement
from climbplan.climb.schema.margins import MarginsSpec

_KEPT_FRACTION = (
    0.95  # of the largest share: at all of it forces have no room left, and cost what they may
)
_NUM_BISECTIONS = 8


@dataclass(frozen=True)
class MarginedGrips:
    """Answers with as much of their margins as is feasible."""

    solved: SolvedGrips
    margin_fraction: Array  # (K,) of the margins that grips keep, at most 1
    required: GripStatement  # the problems with all of their margins


def solve_grips_with_margins(
    statement: GripStatement,
    margins: MarginsSpec,
    weight: float,
    rounds: IntArray,
    solver: str,
    facets: int,
) -> MarginedGrips:
    """Solve and check all instants of a robot with as much of their margins as is feasible.

    Instants are missing in the answer only where there are no grips without margins either.

    Args:
        statement: The force problems of K instants.
        margins: Margins of the spec.
        weight: Weight of the robot [N].
        rounds: (K,) rounds of the instants, counted from 1.
        solver: Name of the force solver.
        facets: Number of sides of the friction pyramids.
    """
    fraction = np.ones(len(statement.load))
    pull = weight * margins.pull * margins.factors(rounds)
    full_statement = _apply_margins(statement, pull, margins.slip, fraction)
    solved = solve_grips(full_statement, solver, facets)
    for k in solved.missing:
        fraction[k] = _find_max_fraction(statement, pull, margins.slip, int(k))
    if not len(solved.missing):
        return MarginedGrips(solved, fraction, full_statement)
    kept_fraction = np.where(fraction < 1.0, _KEPT_FRACTION * fraction, 1.0)
    relaxed_solution = solve_grips(
        _apply_margins(statement, pull, margins.slip, kept_fraction), solver, facets
    )
    return MarginedGrips(relaxed_solution, kept_fraction, full_statement)


def _apply_margins(
    statement: GripStatement, pull: Array, slip: float, fraction: Array
) -> GripStatement:
    """Return the problems with a fraction (K,) of a pull (K,) [N] and of the friction loss `slip`.

    Open grippers hold no pull.
    """
    can_grip = statement.gripper.max_force > 0
    return replace(
        statement,
        safety_friction=np.maximum(statement.safety_friction, 1 / (1 - fraction * slip)),
        pull=fraction * pull if can_grip else np.zeros(len(pull)),
    )


def _find_max_fraction(statement: GripStatement, pull: Array, slip: float, k: int) -> float:
    """Return the largest fraction of instant k on the exact cones, from below; 0 without any."""
    low, high = 0.0, 1.0
    for _ in range(_NUM_BISECTIONS):
        middle = (low + high) / 2
        candidate = _apply_margins(statement, pull, slip, np.full(len(pull), middle))
        if solve_by_clarabel(build_grip_instant(candidate, k)) is None:
            high = middle
        else:
            low = middle
    return low
