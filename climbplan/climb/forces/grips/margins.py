"""Margins of grips: what they hold beside what the plan needs of them.

Each instant is asked that every grip hold a further pull, and that palms and fingers stay where
friction and spines are less than believed (`margins.pull`, `margins.slip` of a spec). Where that
cannot be had the largest common share t of both is found by bisection: what is feasible at one
share is so at any smaller one. Then grips of least cost at nearly that share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.grips.program import grip_instant
from climbplan.climb.forces.grips.solving import SolvedGrips, by_clarabel, solve_grips
from climbplan.climb.forces.grips.statement import GripStatement
from climbplan.climb.schema.margins import MarginsSpec

_KEPT = 0.95  # of the largest share: at all of it forces have no room left, and cost what they may
_BISECTIONS = 8


@dataclass(frozen=True)
class MarginedGrips:
    """Answers with as much of their margins as can be had."""

    solved: SolvedGrips
    share: Array  # (K,) of the margins that grips keep, at most 1
    asked: GripStatement  # the problems with all of their margins


def solve_with_margins(
    statement: GripStatement,
    margins: MarginsSpec,
    weight: float,
    rounds: IntArray,
    solver: str,
    facets: int,
) -> MarginedGrips:
    """Solve and check all instants, in rounds (K,) counted from 1, of a robot of weight [N].

    Instants are missing in the answer only where there are no grips without margins either.
    """
    share = np.ones(len(statement.load))
    pull = weight * margins.pull * margins.factors(rounds)
    asked = _asking(statement, pull, margins.slip, share)
    solved = solve_grips(asked, solver, facets)
    for k in solved.missing:
        share[k] = _largest_share(statement, pull, margins.slip, int(k))
    if not len(solved.missing):
        return MarginedGrips(solved, share, asked)
    kept = np.where(share < 1.0, _KEPT * share, 1.0)
    again = solve_grips(_asking(statement, pull, margins.slip, kept), solver, facets)
    return MarginedGrips(again, kept, asked)


def _asking(statement: GripStatement, pull: Array, slip: float, share: Array) -> GripStatement:
    """The problems with a share (K,) of a pull (K,) [N] and of the friction that may be lacking.

    Open grippers hold no pull.
    """
    closed = statement.gripper.max_force > 0
    return replace(
        statement,
        safety_friction=np.maximum(statement.safety_friction, 1 / (1 - share * slip)),
        pull=share * pull if closed else np.zeros(len(pull)),
    )


def _largest_share(statement: GripStatement, pull: Array, slip: float, k: int) -> float:
    """The largest share of instant k on the exact cones, from below; 0 without any."""
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        asked = _asking(statement, pull, slip, np.full(len(pull), middle))
        if by_clarabel(grip_instant(asked, k)) is None:
            high = middle
        else:
            low = middle
    return low
