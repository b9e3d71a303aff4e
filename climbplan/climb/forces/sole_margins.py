"""Forces on flat feet with a margin of their soles, as far as it is feasible.

A centre of pressure that stays inside by a part of the sole is that of forces at the corners of a
smaller sole. So the margin changes the contact points, not the constraints. Where a smaller sole
has no forces, half of the margin is tried, then the whole sole.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.forces.margins import (
    MarginedForces,
    get_margin_request,
    solve_with_margins,
)
from climbplan.climb.forces.statement import ForceStatement, build_force_statement
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.mechanics.flat_contact import spread_to_corners

MARGIN_FRACTIONS = (1.0, 0.5, 0.0)  # of the margin, tried in turn


def solve_with_sole_margins(
    scene: MotionScene, instants: Instants, solver: str
) -> tuple[ForceStatement, MarginedForces]:
    """Return the force problems of a scene's instants, and their answers with margins.

    With flat feet the statement is that of whole soles, and forces are at their corners.
    """
    facets, request = scene.spec.force.facets, get_margin_request(scene)
    statement = build_force_statement(scene, instants)
    margin = scene.spec.margins.sole
    if scene.robot.sole is None or margin == 0:
        return statement, solve_with_margins(request, statement, solver, facets)
    rows: IntArray = np.arange(instants.count)
    margined: MarginedForces | None = None
    for fraction in MARGIN_FRACTIONS:
        selected = _select_instants(instants, rows)
        reduced_statement = build_force_statement(scene, selected, fraction * margin)
        attempt = solve_with_margins(request, reduced_statement, solver, facets)
        force = attempt.solved.force.reshape(len(rows), -1, statement.points, 3)
        full_sole_force = spread_to_corners(force, fraction * margin).reshape(
            attempt.solved.force.shape
        )
        kept_fraction = np.minimum(attempt.margin_fraction, fraction)
        if margined is None:
            margined = replace(
                attempt,
                solved=replace(attempt.solved, force=full_sole_force),
                margin_fraction=kept_fraction,
            )
        else:
            margined.solved.force[rows], margined.margin_fraction[rows] = (
                full_sole_force,
                kept_fraction,
            )
            solved = replace(
                margined.solved,
                missing=rows[attempt.solved.missing],
                unbalanced=rows[attempt.solved.unbalanced],
                num_resolved=margined.solved.num_resolved + attempt.solved.num_resolved,
            )
            margined = replace(margined, solved=solved)
        rows = np.union1d(margined.solved.missing, margined.solved.unbalanced).astype(np.int64)
        if not len(rows):
            break
    assert margined is not None
    return statement, margined


def _select_instants(instants: Instants, rows: IntArray) -> Instants:
    """Return some of the instants."""
    return Instants(**{name: value[rows] for name, value in vars(instants).items()})
