"""What a bookshelf plan says about itself, recomputed from its file alone.

The geometry is judged by the exact check of the plan's meaning; what is stored beside it (costs,
overlaps, statuses, bounds, the spec) is compared with what the stored scenes and poses give.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray
from climbplan.bookshelf.check.checks import NamedResidual
from climbplan.bookshelf.check.meanings import check_placements, fit_side_by_side
from climbplan.bookshelf.plan.shelf_plan import (
    NO_STATE,
    ShelfPlan,
    Solutions,
    totals_of,
    worst_overlap,
)
from climbplan.bookshelf.scene.rectangles import slots
from climbplan.bookshelf.scene.scene_source import scenes_of, scenes_of_inline, shelf_of
from climbplan.bookshelf.scene.shelf_scene import Scenes, State, movement_cost
from climbplan.bookshelf.schema.model import BookshelfSpec, ShelfSolverSpec
from climbplan.errors import SpecError, UsageError
from climbplan.schema.holding import HeldSpec
from climbplan.schema.kinds import validate
from climbplan.schema.yaml_source import parse_yaml
from climbplan.verification.check import Check, LeftOut, Limit
from climbplan.verification.held import held_check

LIMITS = {
    "file.spec_hash": Limit(0, "", "sha256 of the spec's text is the stored one"),
    "file.finite": Limit(0, "", "numbers that are NaN or infinite where they must not be"),
    "scenes.data": Limit(0, "", "stored scenes whose numbers cannot be those of books"),
    "file.spec_values": Limit(1e-9, "", "shelf, scene, meaning, method and seed are the spec's"),
    "file.totals": Limit(1e-9, "", "status, objective, bound and gap are those of the scenes"),
    "solution.rows": Limit(0, "", "scenes whose status, pose, states and cost do not go together"),
    "solution.objective": Limit(1e-6, "", "costs are those of the stored poses (relative)"),
    "solution.overlap": Limit(1e-9, "m", "overlaps are those of the stored poses"),
    "solution.slot": Limit(0, "", "scenes whose slot is not where the inserted book stands"),
    "solution.bound": Limit(1e-6, "mm^2", "no bound exceeds its cost"),
    "solution.gap": Limit(1e-6, "mm^2", "`optimal` costs are within the spec's gap of the bound"),
    "solution.infeasible": Limit(0, "", "`infeasible` scenes whose books fit side by side"),
}
MEANINGS = {
    "book.overlap": "no two books overlap",
    "book.wall": "books stay between the walls",
    "book.ground": "books rest on the ground",
    "book.clear_height": "books stay below the clear height",
    "book.state": "angles are those of the states",
    "book.stability": "leaning books tilt far enough for gravity to hold them",
    "book.support": "leaning books touch what they lean on",
    "book.order": "stored books keep their order",
    "book.inside": "corners inside the published frame",
    "book.rotation": "books are not upside down",
    "book.separation": "a line separates each two books",
}


def plan_checks(plan: ShelfPlan, held: HeldSpec | None = None) -> Iterator[Check]:
    """All checks; if text or numbers are unsound only those, as nothing else would mean much.

    held: a spec that the plan is to answer in place of its own.
    """
    digest = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    yield _judge("file.spec_hash", float(digest != plan.spec_sha256), "the text was changed")
    yield _faults("file.finite", plan.not_finite)
    wrong = plan.scenes.faults()
    yield _faults("scenes.data", wrong)
    if plan.not_finite or wrong:
        return
    directory = None
    if held is not None:
        yield held_check(held)
        plan, directory = replace(plan, spec_text=held.text), held.directory
    spec = _spec_of(plan)
    yield _spec_values(plan, spec, directory)
    yield _totals(plan)
    yield from solution_checks(plan, spec.solver if isinstance(spec, BookshelfSpec) else None)


def solution_checks(plan: ShelfPlan, solver: ShelfSolverSpec | None) -> Iterator[Check]:
    """The scenes and their solutions; `optimal` is judged by the gaps of `solver`."""
    yield _faults("solution.rows", list(_row_faults(plan.solutions, plan.scenes)))
    yield from _scene_checks(plan, solver)
    placed = plan.solutions.placed
    if placed.any():
        check = check_placements(
            _chosen(plan.scenes, placed),
            plan.solutions.pose[placed],
            plan.solutions.state[placed],
            plan.shelf,
            plan.meaning,
        )
        scenes = np.flatnonzero(placed)
        yield from (_constraint(item, scenes, len(plan.scenes)) for item in check.items)


def _spec_of(plan: ShelfPlan) -> BookshelfSpec | str:
    """The validated spec, or what is wrong with it."""
    try:
        spec, findings = validate(parse_yaml(plan.spec_text, "spec"), BookshelfSpec)
    except SpecError as error:
        return str(error).splitlines()[0]
    return findings[0].message if spec is None else spec


def _spec_values(plan: ShelfPlan, spec: BookshelfSpec | str, directory: Path | None) -> Check:
    """Shelf, scenes and the rest are the spec's; a file of scenes is read below `directory`."""
    if isinstance(spec, str):
        return _judge("file.spec_values", math.inf, spec)
    asked, stored = shelf_of(spec.shelf), plan.shelf
    apart = {
        "seed": 0.0 if plan.seed == spec.seed else math.inf,
        "meaning": 0.0 if plan.meaning == spec.meaning else math.inf,
        "solver.method": 0.0 if plan.method == spec.solver.method else math.inf,
    }
    for name, value in vars(asked).items():
        if name != "published":
            apart[f"shelf.{name}"] = abs(value - vars(stored)[name])
    for name, value in vars(asked.published).items():
        apart[f"shelf.published.{name}"] = abs(value - vars(stored.published)[name])
    if spec.scene is not None:
        apart["scene"] = _scenes_apart(plan.scenes, scenes_of_inline(spec.scene))
    elif spec.scenes is not None and directory is not None:
        try:
            apart["scenes"] = _scenes_apart(plan.scenes, scenes_of(spec, directory))
        except UsageError as error:
            return _judge("file.spec_values", math.inf, str(error).splitlines()[0])
    worst = max(apart, key=lambda key: apart[key])
    check = _judge("file.spec_values", apart[worst], worst)
    if spec.scenes is None or directory is not None:
        return check
    where = f"scenes not compared, they are from {spec.scenes.file}: taken from the plan file"
    lacks = LeftOut("scenes as stored", f"the scenes are the plan's, not {spec.scenes.file}'s")
    return replace(check, margin=where, left_out=lacks)


def _scenes_apart(stored: Scenes, asked: Scenes) -> float:
    theta, written = stored.theta(), asked.theta()
    return float(np.abs(theta - written).max()) if theta.shape == written.shape else math.inf


def _totals(plan: ShelfPlan) -> Check:
    stored, found = plan.totals, totals_of(plan.solutions)
    apart = {"status": 0.0 if stored.status == found.status else math.inf}
    for name in ("objective", "bound", "gap"):
        a, b = vars(stored)[name], vars(found)[name]
        if (a is None) != (b is None):
            apart[name] = math.inf
        elif a is not None:
            apart[name] = abs(a - b) / max(1.0, abs(found.objective))
    worst = max(apart, key=lambda key: math.inf if math.isnan(apart[key]) else apart[key])
    return _judge("file.totals", apart[worst], worst)


def _row_faults(found: Solutions, scenes: Scenes) -> Iterator[str]:
    """Scenes that have only part of a placement, or one that their status denies."""
    placed, many = found.placed, len(scenes) > 1
    nowhere = np.asarray(np.isnan(found.pose).all(axis=(1, 2)), bool)
    known = np.asarray(((found.state >= 0) & (found.state < len(State))).all(axis=1), bool)
    no_state = np.asarray((found.state == NO_STATE).all(axis=1), bool)
    for k, status in enumerate(found.status):
        said = status in ("optimal", "feasible")
        if placed[k]:
            whole = known[k] and 0 <= found.slot[k] <= scenes.count
            whole = whole and math.isfinite(found.objective[k])
        else:
            whole = nowhere[k] and no_state[k] and found.slot[k] == NO_STATE
            whole = whole and found.objective[k] == math.inf and bool(np.isnan(found.overlap[k]))
        if said != placed[k] or not whole:
            what = f"status {status}, pose {'there' if placed[k] else 'missing'}"
            yield f"scene {k}: {what}" if many else what


def _scene_checks(plan: ShelfPlan, solver: ShelfSolverSpec | None) -> Iterator[Check]:
    """Costs, overlaps, slots, bounds and statuses, scene by scene."""
    found, scenes = plan.solutions, plan.scenes
    placed = found.placed
    cost = movement_cost(scenes, found.pose)
    off = np.abs(found.objective - cost) / np.maximum(1.0, cost)
    yield _worst("solution.objective", off, placed)
    depth = worst_overlap(scenes, found.pose)
    yield _worst("solution.overlap", np.abs(found.overlap - depth), placed)
    elsewhere = (found.slot != slots(found.pose, scenes.sizes)).astype(float)
    yield _worst("solution.slot", elsewhere, placed)
    yield _worst("solution.bound", found.bound - found.objective, placed)
    optimal = np.array([status == "optimal" for status in found.status])
    if solver is not None:
        allowed = np.maximum(solver.gap_mm2, solver.gap * found.objective)
        gap = found.objective - found.bound - allowed * (1 + 1e-6)
        yield _worst("solution.gap", gap, placed & optimal)
    infeasible = np.array([status == "infeasible" for status in found.status])
    if plan.meaning == "contact":
        fits = fit_side_by_side(scenes, plan.shelf).astype(float)
        yield _worst("solution.infeasible", fits, infeasible)


def _constraint(item: NamedResidual, scenes: NDArray[np.intp], total: int) -> Check:
    """One constraint of the exact check; the worst scene."""
    severity = item.severity
    worst = int(np.argmax(severity))
    residual = float(item.residual[worst])
    place = f"scene {scenes[worst]}, {item.place[worst]}" if total > 1 else item.place[worst]
    # 1 at the limit, towards 0 the more there is to spare: tells which constraint is nearest.
    passed = bool(item.passed.all())
    used = item.limit / (2 * item.limit - residual) if passed and item.limit > 0 else 1.0
    unit = f" {item.unit}" if item.unit else ""
    margin = f"{residual:.2g} of {item.limit:g}{unit}" if residual > 0 else ""
    return Check(item.name, residual, item.limit, item.unit, passed, margin, place, used)


def _worst(name: str, residuals: Array, rows: BoolArray) -> Check:
    """A check over the scenes `rows`; NaN is worse than anything."""
    scenes = np.flatnonzero(rows)
    if len(scenes) == 0:
        return _judge(name, 0.0)
    values = np.where(np.isnan(residuals[scenes]), np.inf, residuals[scenes])
    worst = int(np.argmax(values))
    return _judge(name, float(values[worst]), f"scene {scenes[worst]}" if len(rows) > 1 else "")


def _faults(name: str, faults: tuple[str, ...] | list[str]) -> Check:
    return _judge(name, float(len(faults)), faults[0] if faults else "")


def _judge(name: str, residual: float, worst_at: str = "") -> Check:
    limit = LIMITS[name]
    residual += 0.0  # no minus zero
    passed = bool(residual <= limit.value)  # False for NaN
    return Check(
        name, residual, limit.value, limit.unit, passed, "", worst_at if residual > 0 else ""
    )


def _chosen(scenes: Scenes, rows: BoolArray) -> Scenes:
    return Scenes(scenes.pose[rows], scenes.size[rows], scenes.inserted[rows])
