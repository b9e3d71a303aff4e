"""Bookshelf scenes as rows of a dataset: sampled, solved, and read back as a plan.

parameters: `theta` of the scene [m, rad]. integers: state of each book, the inserted one last, then
its slot. solution: pose (B, 3), state (B), slot, candidates_tried, nodes.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.bookshelf.generator import DropRules, draw_scene, shelf_for
from climbplan.bookshelf.methods import MethodSetting, prepare
from climbplan.bookshelf.plan import NO_STATE, ShelfPlan, Solutions, totals_of, worst_overlap
from climbplan.bookshelf.runs import checked, compile_first
from climbplan.bookshelf.scene import Array, PublishedTolerances, Scene, Scenes, Shelf
from climbplan.bookshelf.scene_file import DATASET_KIND
from climbplan.bookshelf.scene_source import shelf_of
from climbplan.errors import PlanFileError, UsageError
from climbplan.plans.dataset import Dataset, DatasetFrame, Indices, solution_layout
from climbplan.plans.dataset_row import RowAnswer
from climbplan.spec.dataset import BookshelfProblemSpec

KIND = DATASET_KIND
_MEANINGS = ("contact", "published")


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


def frame_of(count: int, shelf: Shelf, meaning: str) -> DatasetFrame:
    """What scenes of `count` stored books on one shelf share."""
    columns = ("x", "y", "angle", "height", "width")
    theta = [f"book_{k}_{column}" for k in range(count) for column in columns]
    facts = {"books": count, "meaning": meaning, "shelf": asdict(shelf)}
    return DatasetFrame(
        kind=KIND,
        problem=KIND,
        facts=facts,
        parameter_names=(*theta, "inserted_height", "inserted_width"),
        integer_names=(*(f"state_{k}" for k in range(count)), "state_inserted", "slot"),
        layouts=_layouts(count),
        objective_unit="mm^2",
    )


def _layouts(count: int) -> dict[str, Any]:
    return {
        "pose": solution_layout((count + 1, 3), "m, m, rad", "shelf"),
        "state": solution_layout((count + 1,), kind="int"),
        "slot": solution_layout((), kind="int"),
        "candidates_tried": solution_layout((), kind="int"),
        "nodes": solution_layout((), kind="int"),
    }


@dataclass(frozen=True)
class ShelfDataset:
    """Scenes of a dataset with their solutions, as a plan, and the row that each stands in."""

    plan: ShelfPlan
    rows: Indices  # (S,)


def shelf_dataset(data: Dataset) -> ShelfDataset:
    """The rows of a dataset that hold a scene.

    Raises:
        UsageError: not a dataset of bookshelf scenes, or none in it.
        PlanFileError: facts or numbers that cannot be those of books on a shelf.
    """
    if data.frame.kind != KIND:
        raise UsageError(f"a dataset of problem {data.frame.problem!r}, expected {KIND!r}")
    count, shelf, meaning = _facts(data.frame)
    rows = np.flatnonzero(data.drawn)
    if not len(rows):
        raise UsageError("no scene in the dataset")
    try:
        scenes = Scenes.as_found(data.parameters[rows])
    except UsageError as error:
        raise PlanFileError(str(error)) from error
    if scenes.count != count or data.frame != frame_of(count, shelf, meaning):
        raise PlanFileError(f"its columns are not those of scenes with {count} stored books")
    if faults := scenes.faults():
        raise PlanFileError(faults[0])
    part = {name: value[rows] for name, value in data.solution.items()}
    feasible = data.feasible[rows]
    part["pose"] = np.where(feasible[:, None, None], part["pose"], math.nan)
    part["slot"] = np.where(feasible, part["slot"], NO_STATE)
    status = tuple("limit" if data.status[k] == "failed" else data.status[k] for k in rows)
    solutions = Solutions(
        **part,
        status=status,
        objective=np.where(feasible, data.objective[rows], math.inf),
        bound=data.bound[rows],
        time=data.time[rows],
        overlap=worst_overlap(scenes, part["pose"]),
        message=tuple(data.message[k] for k in rows),
    )
    plan = ShelfPlan(
        name=data.name,
        title=data.title,
        shelf=shelf,
        meaning=meaning,
        method=str(data.solvers.get("method", "")),
        scenes=scenes,
        solutions=solutions,
        totals=totals_of(solutions),
        spec_text=data.spec_text,
        spec_sha256=data.spec_sha256,
        seed=data.base_seed,
        timings=dict(data.timings),
        solvers=dict(data.solvers),
        sizes={},
        verified=data.verified,
        created=data.created,
        climbplan_version=data.climbplan_version,
    )
    return ShelfDataset(plan, rows)


def _facts(frame: DatasetFrame) -> tuple[int, Shelf, str]:
    """Stored books, shelf and meaning."""
    facts = frame.facts
    count, meaning, numbers = facts.get("books"), facts.get("meaning"), facts.get("shelf")
    if type(count) is not int or not 1 <= count <= 1000 or meaning not in _MEANINGS:
        raise PlanFileError(f"facts: {count!r} books with meaning {meaning!r}")
    published = numbers.get("published") if isinstance(numbers, dict) else None
    if not isinstance(numbers, dict) or not isinstance(published, dict):
        raise PlanFileError("facts: no numbers of the shelf")
    own = {field.name for field in fields(Shelf)} - {"published"}
    theirs = {field.name for field in fields(PublishedTolerances)}
    given = {**{k: v for k, v in numbers.items() if k != "published"}, **published}
    known = own | theirs
    if set(given) != known or not all(type(v) in (int, float) for v in given.values()):
        raise PlanFileError(f"facts: the shelf has numbers {', '.join(sorted(known))}")
    try:
        shelf = Shelf(
            **{name: float(numbers[name]) for name in own},
            published=PublishedTolerances(**{name: float(published[name]) for name in theirs}),
        )
    except (UsageError, KeyError, OverflowError) as error:  # OverflowError: a number of many digits
        raise PlanFileError(f"facts: {error}") from error
    return count, shelf, str(meaning)
