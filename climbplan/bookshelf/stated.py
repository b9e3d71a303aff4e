"""A bookshelf scene as a problem of the common table, judged by the checker of placements."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from climbplan.bookshelf.check.meanings import check_placements
from climbplan.bookshelf.points import as_stored, placement_of, point_of, settled, theta_of
from climbplan.bookshelf.scene import Array, Scene, Scenes, Shelf
from climbplan.bookshelf.statement import bookshelf
from climbplan.program.problem import Problem
from climbplan.spec.bookshelf.model import Meaning


def shelf_problem(scene: Scene, shelf: Shelf, meaning: Meaning) -> tuple[Problem, dict[str, Array]]:
    """The problem of scenes with as many books, and the parameters of this one [mm, rad].

    It starts from the stored books as they are, the new one upright in the widest gap.
    """
    program = bookshelf(scene.count, shelf, meaning)
    begun = point_of(program, scene, as_stored(scene))
    start = {name: program.value(name, begun) for name in program.variables}

    def check(theta: object, values: Mapping[str, Array]) -> dict[str, float]:
        placement = placement_of(program, scene, program.point(values))
        if meaning == "contact":
            placement = settled(scene, placement)
        found = check_placements(
            Scenes.of([scene]), placement.pose[None], placement.state[None], shelf, meaning
        )
        beyond = {item.name: float(item.residual[0] - item.limit) for item in found.items}
        return {name: 0.0 if np.isfinite(v) and v <= 0 else v for name, v in beyond.items()}

    problem = Problem("bookshelf", program, start=lambda theta: start, check=check)
    return problem, theta_of(scene)
