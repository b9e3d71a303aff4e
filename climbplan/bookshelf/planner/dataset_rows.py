"""Bookshelf scenes as rows of a dataset: sampled and solved."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.table import prepare
from climbplan.bookshelf.plan.dataset_frame import frame_of
from climbplan.bookshelf.plan.shelf_plan import Solutions
from climbplan.bookshelf.planner.runs import checked, compile_first
from climbplan.bookshelf.scene.generator import DropRules, draw_scene, shelf_for
from climbplan.bookshelf.scene.scene_source import shelf_of
from climbplan.bookshelf.scene.shelf_scene import Scene, Scenes
from climbplan.bookshelf.schema.dataset import BookshelfProblemSpec
from climbplan.store.dataset import DatasetFrame
from climbplan.store.dataset_row import RowAnswer


class ShelfRows:
    """Draws scenes and solves them, each answer through the exact check of its meaning."""

    def __init__(self, spec: BookshelfProblemSpec, directory: Path, seed: int) -> None:
        """directory: where the spec's files are looked up. Raises as `methods.prepare` does."""
        self._rules = rules_of(spec)
        self._count = spec.books
        shelf = shelf_for(spec.books, self._rules) if spec.shelf is None else shelf_of(spec.shelf)
        self._setting = MethodSetting(shelf, spec.meaning, spec.solver, directory, seed)
        compile_first(self._setting)
        self._method = prepare(self._setting, spec.books)
        self._frame = frame_of(spec.books, shelf, spec.meaning)

    @property
    def frame(self) -> DatasetFrame:
        """Books, shelf and meaning."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> Scene:
        """A dropped scene; raises LimitReached if none comes to rest."""
        return draw_scene(rng, self._count, self._rules)

    def parameters(self, drawn: Scene) -> Array:
        """`theta` in metres."""
        row: Array = Scenes.of([drawn]).theta()[0]
        return row

    def solve(self, drawn: Scene) -> RowAnswer:
        """The checked answer of the spec's method."""
        scenes = Scenes.of([drawn])
        answer = checked(scenes, [self._method.solve(drawn)], self._setting)[0]
        found = Solutions.of(scenes, [answer])
        placed = answer.placement is not None
        return RowAnswer(
            status=answer.status,
            message=found.message[0],
            solution={name: vars(found)[name][0] for name in self._frame.layouts},
            integers=np.append(found.state[0], found.slot[0]),
            objective=answer.objective if placed else math.nan,
            bound=answer.bound,
            time=answer.seconds,
        )


def rules_of(spec: BookshelfProblemSpec) -> DropRules:
    """How a spec has books dropped."""
    drop = spec.drop
    return DropRules(
        width_mm=drop.width_mm,
        height_mm=drop.height_mm,
        tilt=drop.tilt,
        room_mm=drop.room_mm,
        upright_kept=drop.upright_kept,
        attempts=drop.attempts,
    )
