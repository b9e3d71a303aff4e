"""Bookshelf scenes as rows of a dataset: sampled and solved."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.table import prepare_method
from climbplan.bookshelf.plan.dataset_frame import build_frame
from climbplan.bookshelf.plan.shelf_plan import Solutions
from climbplan.bookshelf.planner.runs import check_answers, compile_solver
from climbplan.bookshelf.scene.generator import DropRules, build_drop_shelf, draw_scene
from climbplan.bookshelf.scene.scene_source import build_shelf
from climbplan.bookshelf.scene.shelf_scene import Scenes, ShelfScene
from climbplan.bookshelf.schema.dataset import BookshelfProblemSpec
from climbplan.store.dataset import DatasetFrame
from climbplan.store.dataset_row import RowAnswer


class ShelfRows:
    """Draws scenes and solves them, each answer through the exact check of its meaning."""

    def __init__(self, spec: BookshelfProblemSpec, directory: Path, seed: int) -> None:
        """directory: where the spec's files are looked up. Raises as `prepare_method` does."""
        self._rules = build_drop_rules(spec)
        self._count = spec.books
        shelf = (
            build_drop_shelf(spec.books, self._rules)
            if spec.shelf is None
            else build_shelf(spec.shelf)
        )
        self._setting = MethodSetting(shelf, spec.formulation, spec.solver, directory, seed)
        compile_solver(self._setting)
        self._method = prepare_method(self._setting, spec.books)
        self._frame = build_frame(spec.books, shelf, spec.formulation)

    @property
    def frame(self) -> DatasetFrame:
        """Books, shelf and meaning."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> ShelfScene:
        """A dropped scene; raises LimitReached if none comes to rest."""
        return draw_scene(rng, self._count, self._rules)

    def parameters(self, scene: ShelfScene) -> Array:
        """`theta` in metres."""
        row: Array = Scenes.of([scene]).theta()[0]
        return row

    def solve(self, scene: ShelfScene) -> RowAnswer:
        """The checked answer of the spec's method."""
        scenes = Scenes.of([scene])
        answer = check_answers(scenes, [self._method.solve(scene)], self._setting)[0]
        solutions = Solutions.of(scenes, [answer])
        placed = answer.placement is not None
        return RowAnswer(
            status=answer.status,
            message=solutions.message[0],
            solution={name: vars(solutions)[name][0] for name in self._frame.layouts},
            integers=np.append(solutions.state[0], solutions.slot[0]),
            objective=answer.objective if placed else math.nan,
            bound=answer.bound,
            time=answer.seconds,
        )


def build_drop_rules(spec: BookshelfProblemSpec) -> DropRules:
    """Build the rules by which a spec drops books."""
    drop = spec.drop
    return DropRules(
        width_mm=drop.width_mm,
        height_mm=drop.height_mm,
        tilt=drop.max_tilt,
        room_mm=drop.frame_width_mm,
        upright_kept=drop.upright_acceptance,
        attempts=drop.max_attempts,
    )
