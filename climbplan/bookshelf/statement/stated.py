"""The bookshelf as a problem of the common table of methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.check.checks import PlacementCheck
from climbplan.bookshelf.check.meanings import check_placements
from climbplan.bookshelf.plan.answer import Placement
from climbplan.bookshelf.scene.shelf_scene import Scene, Scenes, Shelf
from climbplan.bookshelf.schema.model import Meaning
from climbplan.bookshelf.statement.points import (
    as_stored,
    features_of,
    placement_of,
    point_of,
    scene_of,
    settled,
)
from climbplan.bookshelf.statement.statement import bookshelf
from climbplan.program import Problem, Program

Features = Callable[[dict[str, Array]], Array]  # of the statement's parameters [mm, rad]


def checked(
    scene: Scene, placement: Placement, shelf: Shelf, meaning: Meaning
) -> tuple[Placement, PlacementCheck]:
    """A placement as the exact check gets it, and what that says.

    In the meaning `contact` angles and heights are those that the states demand: what a solver
    leaves of rounding does not count.
    """
    if meaning == "contact":
        placement = settled(scene, placement)
    pose, state = placement.pose[None], placement.state[None]
    return placement, check_placements(Scenes.of([scene]), pose, state, shelf, meaning)


def shelf_problem(
    count: int,
    shelf: Shelf,
    meaning: Meaning,
    features: Features = features_of,
    program: Program | None = None,
) -> Problem:
    """The problem of all scenes with as many stored books; its parameters are `points.theta_of`.

    It starts from the stored books as they are, the new one upright in the widest gap (the manual
    start of chapter 8.1.3.2). program: of `bookshelf`, if it was stated before.
    """
    stated = bookshelf(count, shelf, meaning) if program is None else program

    def start(theta: Any) -> dict[str, Array]:
        scene = scene_of(theta)
        begun = point_of(stated, scene, as_stored(scene))
        return {name: stated.value(name, begun) for name in stated.variables}

    def check(theta: Any, values: Mapping[str, Array]) -> dict[str, float]:
        scene = scene_of(theta)
        placement = placement_of(stated, scene, stated.point(values))
        _, found = checked(scene, placement, shelf, meaning)
        beyond = {item.name: float(item.residual[0] - item.limit) for item in found.items}
        return {name: 0.0 if np.isfinite(v) and v <= 0 else v for name, v in beyond.items()}

    return Problem(
        "bookshelf",
        stated,
        features=lambda theta: features({name: np.asarray(v) for name, v in theta.items()}),
        start=start,
        check=check,
    )
