"""The bookshelf problem in the form that the common table of methods solves.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.check.checks import PlacementCheck
from climbplan.bookshelf.check.meanings import check_placements
from climbplan.bookshelf.plan.answer import Placement
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene
from climbplan.bookshelf.schema.model import Meaning
from climbplan.bookshelf.statement.points import (
    build_initial_placement,
    build_point,
    compute_features,
    extract_placement,
    scene_of,
    snap_to_states,
)
from climbplan.bookshelf.statement.statement import build_bookshelf_program
from climbplan.program import Problem, Program

Features = Callable[[dict[str, Array]], Array]  # of the statement's parameters [mm, rad]


def check_solver_placement(
    scene: ShelfScene, placement: Placement, shelf: Shelf, meaning: Meaning
) -> tuple[Placement, PlacementCheck]:
    """Check the placement of a solver; returns the checked placement, too.

    In the meaning `contact` angles and heights are set to those that the states prescribe, which
    removes the rounding of solvers.
    """
    if meaning == "contact":
        placement = snap_to_states(scene, placement)
    pose, state = placement.pose[None], placement.state[None]
    return placement, check_placements(Scenes.of([scene]), pose, state, shelf, meaning)


def build_shelf_problem(
    count: int,
    shelf: Shelf,
    meaning: Meaning,
    features: Features = compute_features,
    program: Program | None = None,
) -> Problem:
    """Build the problem of all scenes with `count` stored books.

    Its parameters come from `build_theta`. It starts from the stored books as they are, with the
    inserted one upright in the widest gap (the manual start of chapter 8.1.3.2).

    Args:
        count: number of stored books.
        shelf: walls, clear height and contact gaps.
        meaning: `contact` or `published`.
        features: the map from parameters to features of learned methods.
        program: from `build_bookshelf_program`; built if left out.
    """
    stated = build_bookshelf_program(count, shelf, meaning) if program is None else program

    def start(theta: Any) -> dict[str, Array]:
        scene = scene_of(theta)
        initial = build_point(stated, scene, build_initial_placement(scene))
        return {name: stated.value(name, initial) for name in stated.variables}

    def check(theta: Any, values: Mapping[str, Array]) -> dict[str, float]:
        scene = scene_of(theta)
        placement = extract_placement(stated, scene, stated.point(values))
        _, placement_check = check_solver_placement(scene, placement, shelf, meaning)
        excess = {item.name: float(item.residual[0] - item.limit) for item in placement_check.items}
        return {name: 0.0 if np.isfinite(v) and v <= 0 else v for name, v in excess.items()}

    return Problem(
        "bookshelf",
        stated,
        features=lambda theta: features({name: np.asarray(v) for name, v in theta.items()}),
        start=start,
        check=check,
    )
