"""The scenes and the library of one comparison: made here by a seed, or from files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.plan.file import write_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, Solutions, compute_totals
from climbplan.bookshelf.scene.generator import build_drop_shelf, generate_scene
from climbplan.bookshelf.scene.scene_file import read_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf
from climbplan.errors import MissingSolver, UsageError
from climbplan.progress import Progress

STORED_BOOKS = 3
_LIBRARY_FROM = 1_000_000  # numbers of generated scenes that go into the library
_HINT = (
    "; or name files: --scenes specs/bookshelf_scenes.h5 and --library, a plan file of "
    "`climbplan solve-bookshelf`"
)


@dataclass(frozen=True)
class Inputs:
    """What all methods of one comparison are given."""

    scenes: Scenes
    shelf: Shelf
    origin: str  # of the scenes, in words


@dataclass(frozen=True)
class FileGroup:
    """A file and one of its groups, "" if none is named."""

    path: Path
    group: str

    @classmethod
    def of(cls, text: str) -> FileGroup:
        """From FILE or FILE:GROUP."""
        if Path(text).exists() or ":" not in text:
            return cls(Path(text), "")
        name, _, group = text.rpartition(":")
        return cls(Path(name), group)


def bench_inputs(source: str | None, count: int, seed: int, report: Progress) -> Inputs:
    """`count` scenes: the first ones of FILE[:GROUP], or generated ones.

    Raises:
        PlanFileError, WrongScenes: a file that cannot be used.
        MissingSolver: pymunk is not installed and no file is named.
    """
    if source is not None:
        place = FileGroup.of(source)
        found = read_scenes(place.path, place.group)
        keep = min(count, len(found))
        scenes = Scenes(found.pose[:keep], found.size[:keep], found.inserted[:keep])
        name = place.path.name + (f":{place.group}" if place.group else "")
        origin = f"{keep} of {len(found)} scenes of {name}"
    else:
        scenes = _generated(seed, 0, count, STORED_BOOKS, "scenes", report)
        origin = f"{count} generated scenes, seed {seed}"
    return Inputs(scenes, build_drop_shelf(scenes.count), origin)


def write_library(inputs: Inputs, size: int, seed: int, path: Path, report: Progress) -> None:
    """Solve `size` generated scenes by `exact` and keep them as a plan file.

    Raises:
        MissingSolver: pymunk is not installed.
    """
    scenes = _generated(seed, _LIBRARY_FROM, size, inputs.scenes.count, "library", report)
    solutions = Solutions.of(scenes, ExactSolver(inputs.shelf).solve_all(scenes))
    plan = ShelfPlan(
        name="library",
        title="",
        shelf=inputs.shelf,
        meaning="contact",
        method="exact",
        scenes=scenes,
        solutions=solutions,
        totals=compute_totals(solutions),
        spec_text="",
        spec_sha256="",
        seed=seed,
        timings={},
        solvers={},
        sizes={},
    )
    write_shelf_plan(plan, path)


def _generated(
    seed: int, first: int, count: int, books: int, stage: str, report: Progress
) -> Scenes:
    if count < 1:
        raise UsageError(f"{stage}: expected at least one scene")
    made = []
    for k in range(count):
        try:
            made.append(generate_scene(seed, first + k, books))
        except MissingSolver as error:
            raise MissingSolver(f"{error}{_HINT}") from error
        report(stage, (k + 1) / count)
    return Scenes.of(made)


def in_turn(cost: np.ndarray, trivial: float) -> list[int]:
    """Scenes by number, those that need movement and those that do not in turn.

    What slow methods get is the first of these: half of them need movement, as far as there are.
    """
    moving = [int(k) for k in np.flatnonzero(cost > trivial)]
    resting = [int(k) for k in np.flatnonzero(~(cost > trivial))]
    order: list[int] = []
    while moving or resting:
        for queue in (moving, resting):
            if queue:
                order.append(queue.pop(0))
    return order
