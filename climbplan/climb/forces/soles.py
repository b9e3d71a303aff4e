"""Forces on flat feet with a margin of their soles, as far as it can be had.

A centre of pressure that is to stay inside by a part of the sole is that of forces at the corners
of a smaller sole: the margin is another statement, not another constraint. Where there are no
forces on it, a sole half as much smaller is tried, then the whole one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.forces.margins import MarginedForces, solve_with_margins
from climbplan.climb.forces.statement import ForceStatement, state_forces
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.mechanics.flat_contact import spread_to_corners

SHARES = (1.0, 0.5, 0.0)  # of the margin, tried in turn


def solve_on_feet(
    scene: MotionScene, instants: Instants, solver: str
) -> tuple[ForceStatement, MarginedForces]:
    """The force problems of a scene's instants, and their answers with margins.

    Of flat feet the statement is that of whole soles, and forces are at their corners.
    """
    facets = scene.spec.force.facets
    statement = state_forces(scene, instants)
    margin = scene.spec.margins.sole
    if scene.robot.sole is None or margin == 0:
        return statement, solve_with_margins(scene, statement, solver, facets)
    rows: IntArray = np.arange(instants.count)
    found: MarginedForces | None = None
    for share in SHARES:
        part = _taken(instants, rows)
        smaller = state_forces(scene, part, share * margin)
        own = solve_with_margins(scene, smaller, solver, facets)
        force = own.solved.force.reshape(len(rows), -1, statement.points, 3)
        spread = spread_to_corners(force, share * margin).reshape(own.solved.force.shape)
        kept = np.minimum(own.share, share)
        if found is None:
            found = replace(own, solved=replace(own.solved, force=spread), share=kept)
        else:
            found.solved.force[rows], found.share[rows] = spread, kept
            solved = replace(
                found.solved,
                missing=rows[own.solved.missing],
                unbalanced=rows[own.solved.unbalanced],
                solved_again=found.solved.solved_again + own.solved.solved_again,
            )
            found = replace(found, solved=solved)
        rows = np.union1d(found.solved.missing, found.solved.unbalanced).astype(np.int64)
        if not len(rows):
            break
    assert found is not None
    return statement, found


def _taken(instants: Instants, rows: IntArray) -> Instants:
    return Instants(**{name: value[rows] for name, value in vars(instants).items()})
