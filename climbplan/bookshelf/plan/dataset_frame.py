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
    compute_totals,
    measure_worst_overlap,
)
from climbplan.bookshelf.scene.scene_file import DATASET_KIND
from climbplan.bookshelf.scene.shelf_scene import PublishedTolerances, Scenes, Shelf
from climbplan.deprecation import current_method_name
from climbplan.errors import PlanFileError, UsageError
from climbplan.store.dataset import Dataset, DatasetFrame, build_solution_layout

KIND = DATASET_KIND
_MEANINGS = ("contact", "published")


def build_frame(count: int, shelf: Shelf, meaning: str) -> DatasetFrame:
    """Build the frame of a dataset: what scenes of `count` stored books on one shelf share."""
    columns = ("x", "y", "angle", "height", "width")
    theta = [f"book_{k}_{column}" for k in range(count) for column in columns]
    facts = {"books": count, "meaning": meaning, "shelf": asdict(shelf)}
    return DatasetFrame(
        kind=KIND,
        problem=KIND,
        facts=facts,
        parameter_names=(*theta, "inserted_height", "inserted_width"),
        integer_names=(*(f"state_{k}" for k in range(count)), "state_inserted", "slot"),
        layouts=_build_layouts(count),
        objective_unit="mm^2",
    )


def _build_layouts(count: int) -> dict[str, Any]:
    return {
        "pose": build_solution_layout((count + 1, 3), "m, m, rad", "shelf"),
        "state": build_solution_layout((count + 1,), kind="int"),
        "slot": build_solution_layout((), kind="int"),
        "candidates_tried": build_solution_layout((), kind="int"),
        "nodes": build_solution_layout((), kind="int"),
    }


@dataclass(frozen=True)
class ShelfDataset:
    """Scenes of a dataset with their solutions, as a plan, and the row that each stands in."""

    plan: ShelfPlan
    rows: IntArray  # (S,)


def read_shelf_dataset(data: Dataset) -> ShelfDataset:
    """Read the rows of a dataset that have a scene.

    Raises:
        UsageError: not a dataset of bookshelf scenes, or none in it.
        PlanFileError: facts or numbers that cannot be those of books on a shelf.
    """
    if data.frame.kind != KIND:
        raise UsageError(f"a dataset of problem {data.frame.problem!r}, expected {KIND!r}")
    count, shelf, meaning = _read_facts(data.frame)
    rows = np.flatnonzero(data.drawn)
    if not len(rows):
        raise UsageError("no scene in the dataset")
    try:
        scenes = Scenes.from_theta_unchecked(data.parameters[rows])
    except UsageError as error:
        raise PlanFileError(str(error)) from error
    if scenes.count != count or data.frame != build_frame(count, shelf, meaning):
        raise PlanFileError(f"its columns are not those of scenes with {count} stored books")
    if faults := scenes.faults():
        raise PlanFileError(faults[0])
    arrays = {name: value[rows] for name, value in data.solution.items()}
    feasible = data.feasible[rows]
    arrays["pose"] = np.where(feasible[:, None, None], arrays["pose"], math.nan)
    arrays["slot"] = np.where(feasible, arrays["slot"], NO_STATE)
    status = tuple("limit" if data.status[k] == "failed" else data.status[k] for k in rows)
    solutions = Solutions(
        **arrays,
        status=status,
        objective=np.where(feasible, data.objective[rows], math.inf),
        bound=data.bound[rows],
        time=data.time[rows],
        overlap=measure_worst_overlap(scenes, arrays["pose"]),
        message=tuple(data.message[k] for k in rows),
    )
    plan = ShelfPlan(
        name=data.name,
        title=data.title,
        shelf=shelf,
        meaning=meaning,
        method=current_method_name("bookshelf", str(data.solvers.get("method", ""))),
        scenes=scenes,
        solutions=solutions,
        totals=compute_totals(solutions),
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


def _read_facts(frame: DatasetFrame) -> tuple[int, Shelf, str]:
    """Read the number of stored books, the shelf and the meaning."""
    facts = frame.facts
    count, meaning, numbers = facts.get("books"), facts.get("meaning"), facts.get("shelf")
    if type(count) is not int or not 1 <= count <= 1000 or meaning not in _MEANINGS:
        raise PlanFileError(
            f"attribute facts: expected a number of books and a formulation, got {count!r} books "
            f"and {meaning!r}"
        )
    published = numbers.get("published") if isinstance(numbers, dict) else None
    if not isinstance(numbers, dict) or not isinstance(published, dict):
        raise PlanFileError("attribute facts: expected the numbers of the shelf, got none")
    shelf_names = {field.name for field in fields(Shelf)} - {"published"}
    published_names = {field.name for field in fields(PublishedTolerances)}
    values = {**{k: v for k, v in numbers.items() if k != "published"}, **published}
    expected_names = shelf_names | published_names
    if set(values) != expected_names or not all(type(v) in (int, float) for v in values.values()):
        raise PlanFileError(
            f"attribute facts: expected numbers {', '.join(sorted(expected_names))} of the shelf"
        )
    try:
        shelf = Shelf(
            **{name: float(numbers[name]) for name in shelf_names},
            published=PublishedTolerances(
                **{name: float(published[name]) for name in published_names}
            ),
        )
    except (UsageError, KeyError, OverflowError) as error:  # OverflowError: a number of many digits
        raise PlanFileError(f"facts: {error}") from error
    return count, shelf, str(meaning)
