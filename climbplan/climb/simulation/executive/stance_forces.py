"""Contact forces of a measured stance, with as much friction in hand as its motors allow.

The planner's force problem (`climb/forces/statement.py`) is solved again for toes where they were
found and for the friction that surfaces have shown. Its margins are larger than those of plans, of
which it keeps the largest common part: a toe that is farther from slipping costs torque that
motors have.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.margins import (
    MARGIN_FIELDS,
    MarginRequest,
    apply_margins,
    solve_with_margins,
)
from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import ForceStatement, build_robot_forces
from climbplan.climb.plan.climb_plan import ClimbPlan, Instants
from climbplan.climb.plan.played import START
from climbplan.climb.schema.force import ForcePlannerSpec
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.robots.kinematics import standing_inverse

_FACETS = 16  # of friction pyramids
_SOLVER = "daqp"
# Least friction safety without margins; S_mu is below the planner's, as friction is measured
_FORCE = ForcePlannerSpec(safety_friction=1.3)
# More than plans keep: motors have the torque, and what is measured is not exact
STANCE_MARGINS = MarginsSpec(
    normal_force=0.15, friction=0.1, slip=0.44, depth=0.005, torque=0.15, stiffness=0.28
)
# Margins of friction with the fraction of all others, in the order of preference. Those with full
# margins are solved together, and the others if none of them has a solution
_FULL_MARGINS = ((0.64, 1.0), (0.58, 1.0), (0.52, 1.0), (0.48, 1.0), (0.44, 1.0))
_PART_MARGINS = tuple((slip, fraction) for fraction in (0.8, 0.6, 0.4, 0.2) for slip in (0.44, 0.3))


@dataclass(frozen=True)
class StanceSolution:
    """Forces of one stance."""

    force: Array  # (N, 3) [N]
    margin_fraction: float  # of the margins that they keep; above 1 of friction


def solve_stance_forces(
    plan: ClimbPlan,
    instant: int,
    toes: Array,
    mu: Array,
    load: Array,
) -> StanceSolution | None:
    """Solve the forces of an instant for measured toes and friction; None if there are none.

    Args:
        plan: The plan.
        instant: Its instant, whose body pose and contacts are wanted; START for the start.
        toes: (N, 3) measured places [m].
        mu: (N,) friction coefficients.
        load: (6,) beside the planned one, about the body's origin [N, N m].
    """
    measured = _measure_instant(plan, instant, toes, mu, load)
    statement = build_robot_forces(plan.robot, _FORCE, measured)
    for fractions in (_FULL_MARGINS, _PART_MARGINS):
        ladder = _require_margins(statement, fractions)
        solved = solve_forces(ladder, _SOLVER, _FACETS, is_quick=True)
        has_solution = np.ones(len(fractions), bool)
        has_solution[solved.missing] = has_solution[solved.unbalanced] = False
        if has_solution.any():
            best = int(np.argmax(has_solution))
            slip, fraction = fractions[best]
            if fraction < 1.0:
                return StanceSolution(solved.force[best], min(fraction, slip / STANCE_MARGINS.slip))
            return StanceSolution(solved.force[best], (1.0 - STANCE_MARGINS.slip) / (1.0 - slip))
    margined = solve_with_margins(MarginRequest(STANCE_MARGINS, True), statement, _SOLVER, _FACETS)
    if len(margined.solved.missing) or len(margined.solved.unbalanced):
        return None
    return StanceSolution(margined.solved.force[0], float(margined.margin_fraction[0]))


def _require_margins(
    statement: ForceStatement, fractions: tuple[tuple[float, float], ...]
) -> ForceStatement:
    """Return the problem of one instant with the margins of each pair of `fractions`."""
    required = [
        vars(apply_margins(statement, _scale_margins(fraction))) for _, fraction in fractions
    ]
    bounds: dict[str, Any] = {
        name: np.concatenate([fields[name] for fields in required]) for name in MARGIN_FIELDS
    }
    factor = [min(1.0, _FORCE.safety_friction * (1.0 - slip)) for slip, _ in fractions]
    return replace(
        statement.take(np.zeros(len(fractions), np.int64)),
        mu=np.array(factor)[:, None] * statement.mu,
        **bounds,
    )


def _scale_margins(fraction: float) -> MarginsSpec:
    """Return a fraction of all margins but that of friction lacking."""
    names = ("normal_force", "friction", "depth", "torque", "stiffness")
    scaled = {name: fraction * getattr(STANCE_MARGINS, name) for name in names}
    return STANCE_MARGINS.model_copy(update=scaled)


def _measure_instant(
    plan: ClimbPlan, instant: int, toes: Array, mu: Array, load: Array
) -> Instants:
    """Return an instant of the plan with standing toes and friction as measured."""
    first = max(instant, 0)
    row: dict[str, Any] = {
        f.name: getattr(plan.instants, f.name)[first : first + 1] for f in fields(Instants)
    }
    if instant == START:
        row["contact"] = np.ones_like(row["contact"])
        row |= {"com": plan.rounds.com[:1], "rpy": plan.rounds.rpy[:1]}
        row["lifted"] = ~row["contact"]
    standing = row["contact"][0]
    places = np.where(standing[:, None], toes, row["toes"][0])[None]
    solution = standing_inverse(plan.robot, row["com"], row["rpy"], places, row["normal"])
    angles = np.where(
        (standing & solution.valid[0])[None, :, None], solution.best(), row["joint_angles"]
    )
    wrench = row["external_wrench"] + load
    return Instants(
        **row | {"toes": places, "mu": mu[None], "joint_angles": angles, "external_wrench": wrench}
    )
