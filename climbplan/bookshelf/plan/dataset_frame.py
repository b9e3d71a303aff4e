"""The columns of bookshelf scenes in a dataset, and its rows as a plan.

parameters: `theta` of the scene [m, rad]. integers: state of each book, the inserted one last, then
its slot. solution: pose (B, 3), state (B), slot, candidates_tried, nodes.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from climbplan.arrays import IntArray
from climbplan.bookshelf.plan.shelf_plan import (
    NO_STATE,
    ShelfPlan,
    Solutions,
    totals_of,
    worst_overlap,
)
from climbplan.bookshelf.scene.scene_file import DATASET_KIND
from climbplan.bookshelf.scene.shelf_scene import PublishedTolerances, Scenes, Shelf
from climbplan.errors import PlanFileError, UsageError
from climbplan.store.dataset import Dataset, DatasetFrame, solution_layout

KIND = DATASET_KIND
_MEANINGS = ("contact", "published")


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
    rows: IntArray  # (S,)


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
