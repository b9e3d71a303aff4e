"""Published placements through the exact check, and against ours at equal allowance.

A published placement may cost less than our optimum only because it breaks a constraint of the
meaning `contact`. Ours is solved again with what a placement takes for itself: first the overlap
(books may penetrate each other by as much), then the room past the walls and the gaps at which
leaning books touch as well. What is cheaper still is so by a constraint that was not granted, which
is named; if there is none, the proof of `exact` is wrong. As every published placement is a little
off the ground and off its states' angles, that alone says little of the proof: it is also held
against the placements brought to these angles and to the ground, at all they then take.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import h5py
import numpy as np

from benchmarks.bookshelf.inputs import FileGroup
from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.check.checker import LENGTH_LIMIT, check_contact
from climbplan.bookshelf.check.checks import PlacementCheck
from climbplan.bookshelf.check.published import check_published, infer_published_states
from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.plan.answer import Placement, SceneAnswer
from climbplan.bookshelf.plan.shelf_plan import measure_worst_overlap
from climbplan.bookshelf.scene.generator import build_drop_shelf
from climbplan.bookshelf.scene.scene_file import read_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene, compute_movement_cost
from climbplan.bookshelf.statement.points import snap_to_states
from climbplan.errors import UsageError
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store

Allowance = Literal["none", "overlap", "lengths"]
ALLOWANCES: tuple[Allowance, ...] = ("none", "overlap", "lengths")
GRANTED: dict[Allowance, frozenset[str]] = {
    "none": frozenset(),
    "overlap": frozenset({"book.overlap"}),
    "lengths": frozenset({"book.overlap", "book.wall", "book.support"}),
}
_BOOKS = 3
_X = DatasetLayout(("S", 30), "mm, rad", "shelf")  # 3 (x, y), 3 angles, inserted x, y, angle, lines
_ROUNDING = 1e-3  # [mm^2] of costs
_HAIR = 1e-7  # [m] on top of what is granted


@dataclass(frozen=True)
class PublishedSet:
    """Placements of a group of a file, poses (S, 4, 3) [m, rad] with the inserted book last."""

    group: str
    scenes: Scenes
    pose: Array


@dataclass(frozen=True)
class Comparison:
    """One published placement against ours at one allowance."""

    group: str
    scene: int
    allowance: Allowance
    published_mm2: float
    ours_mm2: float  # infinite if no placement was found
    bound_mm2: float  # nothing costs less at this allowance: proved
    cheaper: bool  # the published one, by more than the gap
    breaks: str  # of the constraints that were not granted the one broken most, "" if none is
    by: float  # its residual [mm or rad]
    unit: str
    overlap_mm: float  # worst of the published placement


@dataclass(frozen=True)
class Broken:
    """How published placements stand to one constraint of one meaning."""

    meaning: str
    name: str
    unit: str
    limit: float
    broken: int
    median: float  # residual over those that break it, NaN if none does
    most90: float
    largest: float


@dataclass(frozen=True)
class Brought:
    """Published placements brought to their states' angles and to the ground, against ours.

    Only those which then break nothing but what ours is granted as well (`lengths`).
    """

    comparable: int
    cheaper: int  # than what `exact` proves, which cannot be


@dataclass(frozen=True)
class PublishedReport:
    """All that is said about the published placements of a file."""

    scenes: int
    brought: Brought
    passed: dict[str, int]  # by meaning
    broken: list[Broken]
    rows: list[Comparison]


def read_published(source: str) -> list[PublishedSet]:
    """Placements of FILE[:GROUP], of all groups with `theta` and `X` if none is named.

    Raises:
        PlanFileError: missing or damaged file, or rows that cannot describe books.
        UsageError: no such group, or scenes of another number of books.
    """
    place = FileGroup.of(source)
    with open_store(place.path) as file:
        names = [name for name in sorted(file) if isinstance(file[name], h5py.Group)]
        names = [name for name in names if "theta" in file[name] and "X" in file[name]]
        if place.group:
            names = [name for name in names if name == place.group]
        if not names:
            raise UsageError(f"{place.path}: no such group with datasets `theta` and `X`")
        points = [Reader(place.path, file).array(f"{name}/X", _X) for name in names]
    sets = []
    for name, x in zip(names, points, strict=True):
        scenes = read_scenes(place.path, name)
        if scenes.count != _BOOKS or len(scenes) != len(x):
            raise UsageError(
                f"{place.path}, {name}: expected a row of X for each of {_BOOKS} books"
            )
        stored = np.dstack([x[:, :6].reshape(-1, _BOOKS, 2), x[:, 6:9]])
        pose = np.concatenate([stored, x[:, None, 9:12]], axis=1) * np.array([1e-3, 1e-3, 1.0])
        sets.append(PublishedSet(name, scenes, pose))
    return sets


def compare_published(
    source: str, limits: ExactLimits, report: Callable[[str, float], None]
) -> PublishedReport:
    """Check and compare all placements of a file; raises as `read_published`."""
    sets = read_published(source)
    shelf, total, done = build_drop_shelf(_BOOKS), sum(len(s.scenes) for s in sets), 0
    checks: dict[str, list[PlacementCheck]] = {"published": [], "contact": []}
    rows: list[Comparison] = []
    comparable = cheaper = 0
    for given in sets:
        state = infer_published_states(given.scenes, given.pose, shelf)
        checks["published"].append(check_published(given.scenes, given.pose, state, shelf))
        contact = check_contact(given.scenes, given.pose, state, shelf)
        checks["contact"].append(contact)
        cost = compute_movement_cost(given.scenes, given.pose)
        overlap = measure_worst_overlap(given.scenes, given.pose)
        for k, scene in enumerate(given.scenes):
            for allowance in ALLOWANCES:
                ours = solve_allowing(scene, shelf, allowance, contact, k, overlap[k], limits)
                rows.append(
                    _compared(given.group, k, allowance, cost[k], ours, contact, overlap[k], limits)
                )
            done += 1
            report("published", done / total)
        held = _brought(given, state, shelf, limits)
        comparable, cheaper = comparable + held.comparable, cheaper + held.cheaper
    return PublishedReport(
        scenes=total,
        brought=Brought(comparable, cheaper),
        passed={name: sum(int(c.passed.sum()) for c in parts) for name, parts in checks.items()},
        broken=[row for parts in checks.values() for row in _broken(parts)],
        rows=rows,
    )


def solve_allowing(
    scene: ShelfScene,
    shelf: Shelf,
    allowance: Allowance,
    check: PlacementCheck,
    row: int,
    overlap: float,
    limits: ExactLimits,
) -> SceneAnswer:
    """Our optimum, given what row `row` of a check took for itself; checked with as much."""
    depth = overlap + _HAIR if allowance != "none" else 0.0
    if allowance == "lengths":
        wall, gap = (1e-3 * _excess(check, name, row) for name in ("book.wall", "book.support"))
        shelf = replace(
            shelf,
            left=shelf.left - wall - _HAIR,
            right=shelf.right + wall + _HAIR,
            book_gap=shelf.book_gap + gap + _HAIR,
            wall_gap=shelf.wall_gap + gap + wall + 2 * _HAIR,  # from the wall that was moved
        )
    answer = ExactSolver(shelf, limits, depth).solve(scene)
    if answer.placement is None:
        return answer
    placed, one = answer.placement, Scenes.of([scene])
    judged = check_contact(one, placed.pose[None], placed.state[None], shelf)
    allowed = {"book.overlap": 1e3 * (depth + LENGTH_LIMIT)}
    for item in judged.items:
        if not item.residual[0] <= allowed.get(item.name, item.limit):
            word = f"the answer breaks {item.name}: {item.residual[0]:.3g} {item.unit}"
            return replace(answer, status="limit", placement=None, objective=math.inf, message=word)
    return answer


def _brought(given: PublishedSet, state: IntArray, shelf: Shelf, limits: ExactLimits) -> Brought:
    pose = np.stack(
        [
            snap_to_states(scene, Placement(given.pose[k], state[k], 0)).pose
            for k, scene in enumerate(given.scenes)
        ]
    )
    check = check_contact(given.scenes, pose, state, shelf)
    cost, overlap = (
        compute_movement_cost(given.scenes, pose),
        measure_worst_overlap(given.scenes, pose),
    )
    comparable = cheaper = 0
    for k, scene in enumerate(given.scenes):
        granted = GRANTED["lengths"]
        if not all(item.name in granted or item.passed[k] for item in check.items):
            continue
        ours = solve_allowing(scene, shelf, "lengths", check, k, overlap[k], limits)
        comparable += 1
        cheaper += bool(cost[k] < ours.bound - _ROUNDING)
    return Brought(comparable, cheaper)


def _compared(
    group: str,
    row: int,
    allowance: Allowance,
    cost: float,
    ours: SceneAnswer,
    check: PlacementCheck,
    overlap: float,
    limits: ExactLimits,
) -> Comparison:
    gap = max(limits.gap_absolute, limits.gap_relative * cost) + _ROUNDING
    left = [i for i in check.items if i.name not in GRANTED[allowance] and not i.passed[row]]
    worst = max(left, key=lambda item: float(item.severity[row]), default=None)
    return Comparison(
        group=group,
        scene=row,
        allowance=allowance,
        published_mm2=float(cost),
        ours_mm2=ours.objective,
        bound_mm2=ours.bound,
        cheaper=bool(cost < ours.objective - gap),
        breaks=worst.name if worst is not None else "",
        by=float(worst.residual[row]) if worst is not None else 0.0,
        unit=worst.unit if worst is not None else "",
        overlap_mm=1e3 * float(overlap),
    )


def _excess(check: PlacementCheck, name: str, row: int) -> float:
    """What a constraint is broken by, zero if it is not."""
    return max(0.0, float(check[name].residual[row]))


def _broken(checks: list[PlacementCheck]) -> list[Broken]:
    rows = []
    for k, first in enumerate(checks[0].items):
        residual = np.concatenate([check.items[k].residual for check in checks])
        over = residual[~(residual <= first.limit)]
        at = np.quantile(over, [0.5, 0.9, 1.0]) if len(over) else np.full(3, math.nan)
        rows.append(
            Broken(
                checks[0].meaning, first.name, first.unit, first.limit, len(over),
                float(at[0]), float(at[1]), float(at[2]),
            )
        )  # fmt: skip
    return rows
