"""Checks of a bookshelf plan, recomputed from its file alone.

The exact check of the plan's meaning evaluates the geometry. Stored costs, overlaps, statuses,
bounds and the spec are compared with the values that the stored scenes and poses give.

Published methods and values are those of X. Lin (UCLA 2022).
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
    compute_totals,
    measure_worst_overlap,
)
from climbplan.bookshelf.scene.rectangles import find_slots
from climbplan.bookshelf.scene.scene_source import (
    build_inline_scenes,
    build_shelf,
    read_spec_scenes,
)
from climbplan.bookshelf.scene.shelf_scene import BookState, Scenes, compute_movement_cost
from climbplan.bookshelf.schema.model import BookshelfSpec, ShelfSolverSpec
from climbplan.errors import SpecError, UsageError
from climbplan.schema.holding import HeldSpec
from climbplan.schema.kinds import validate
from climbplan.schema.yaml_source import parse_yaml
from climbplan.verification.check import Check, LeftOut, Limit
from climbplan.verification.held import check_spec_differences

LIMITS = {
    "file.spec_hash": Limit(0, "", "sha256 of the spec's text is the stored one"),
    "file.finite": Limit(0, "", "numbers that are NaN or infinite where they must not be"),
    "scenes.data": Limit(0, "", "stored scenes whose numbers cannot be those of books"),
    "file.spec_values": Limit(
        1e-9, "", "shelf, scene, formulation, method and seed are the spec's"
    ),
    "file.totals": Limit(1e-9, "", "status, objective, bound and gap are those of the scenes"),
    "solution.consistency": Limit(
        0, "", "scenes whose status, pose, states and cost do not go together"
    ),
    "file.objective": Limit(1e-6, "", "costs are those of the stored poses (relative)"),
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


def check_plan(plan: ShelfPlan, replacement_spec: HeldSpec | None = None) -> Iterator[Check]:
    """Run all checks; if text or numbers are unsound only those, as others would mean little.

    Args:
        plan: as read from its file, with numbers that may be NaN.
        replacement_spec: a spec that the plan is compared with in place of its own.
    """
    digest = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    yield _compare_with_limit(
        "file.spec_hash", float(digest != plan.spec_sha256), "the text was changed"
    )
    yield _check_fault_count("file.finite", plan.not_finite)
    wrong = plan.scenes.faults()
    yield _check_fault_count("scenes.data", wrong)
    if plan.not_finite or wrong:
        return
    directory = None
    if replacement_spec is not None:
        yield check_spec_differences(replacement_spec)
        plan, directory = replace(plan, spec_text=replacement_spec.text), replacement_spec.directory
    spec = _parse_spec(plan)
    yield _check_spec_values(plan, spec, directory)
    yield _check_totals(plan)
    yield from check_solutions(plan, spec.solver if isinstance(spec, BookshelfSpec) else None)


def check_solutions(plan: ShelfPlan, solver: ShelfSolverSpec | None) -> Iterator[Check]:
    """Check the scenes and their solutions; `optimal` must be within the gaps of `solver`."""
    yield _check_fault_count(
        "solution.consistency", list(_find_row_faults(plan.solutions, plan.scenes))
    )
    yield from _check_scenes(plan, solver)
    placed = plan.solutions.placed
    if placed.any():
        check = check_placements(
            _select_scenes(plan.scenes, placed),
            plan.solutions.pose[placed],
            plan.solutions.state[placed],
            plan.shelf,
            plan.meaning,
        )
        scenes = np.flatnonzero(placed)
        yield from (_build_constraint_check(item, scenes, len(plan.scenes)) for item in check.items)


def _parse_spec(plan: ShelfPlan) -> BookshelfSpec | str:
    """Return the validated spec, or the message of its first mistake."""
    try:
        spec, findings = validate(parse_yaml(plan.spec_text, "spec"), BookshelfSpec)
    except SpecError as error:
        return str(error).splitlines()[0]
    return findings[0].message if spec is None else spec


def _check_spec_values(plan: ShelfPlan, spec: BookshelfSpec | str, directory: Path | None) -> Check:
    """Compare the plan with its spec; a file of scenes is read from `directory`."""
    if isinstance(spec, str):
        return _compare_with_limit("file.spec_values", math.inf, spec)
    expected, stored = build_shelf(spec.shelf), plan.shelf
    difference = {
        "seed": 0.0 if plan.seed == spec.seed else math.inf,
        "formulation": 0.0 if plan.meaning == spec.formulation else math.inf,
        "solver.method": 0.0 if plan.method == spec.solver.method else math.inf,
    }
    for name, value in vars(expected).items():
        if name != "published":
            difference[f"shelf.{name}"] = abs(value - vars(stored)[name])
    for name, value in vars(expected.published).items():
        difference[f"shelf.published.{name}"] = abs(value - vars(stored.published)[name])
    if spec.scene is not None:
        difference["scene"] = _compare_scenes(plan.scenes, build_inline_scenes(spec.scene))
    elif spec.scenes is not None and directory is not None:
        try:
            difference["scenes"] = _compare_scenes(plan.scenes, read_spec_scenes(spec, directory))
        except UsageError as error:
            return _compare_with_limit("file.spec_values", math.inf, str(error).splitlines()[0])
    worst = max(difference, key=lambda key: difference[key])
    check = _compare_with_limit("file.spec_values", difference[worst], worst)
    if spec.scenes is None or directory is not None:
        return check
    where = f"scenes not compared, they are from {spec.scenes.file}: taken from the plan file"
    lacks = LeftOut("scenes as stored", f"the scenes are the plan's, not {spec.scenes.file}'s")
    return replace(check, margin=where, left_out=lacks)


def _compare_scenes(stored: Scenes, expected: Scenes) -> float:
    theta, expected_theta = stored.theta(), expected.theta()
    return (
        float(np.abs(theta - expected_theta).max())
        if theta.shape == expected_theta.shape
        else math.inf
    )


def _check_totals(plan: ShelfPlan) -> Check:
    stored, recomputed = plan.totals, compute_totals(plan.solutions)
    difference = {"status": 0.0 if stored.status == recomputed.status else math.inf}
    for name in ("objective", "bound", "gap"):
        a, b = vars(stored)[name], vars(recomputed)[name]
        if (a is None) != (b is None):
            difference[name] = math.inf
        elif a is not None:
            difference[name] = abs(a - b) / max(1.0, abs(recomputed.objective))
    worst = max(
        difference, key=lambda key: math.inf if math.isnan(difference[key]) else difference[key]
    )
    return _compare_with_limit("file.totals", difference[worst], worst)


def _find_row_faults(solutions: Solutions, scenes: Scenes) -> Iterator[str]:
    """Yield a message for each scene with part of a placement, or one that its status denies."""
    placed, has_many = solutions.placed, len(scenes) > 1
    has_no_pose = np.asarray(np.isnan(solutions.pose).all(axis=(1, 2)), bool)
    is_state = np.asarray(
        ((solutions.state >= 0) & (solutions.state < len(BookState))).all(axis=1), bool
    )
    no_state = np.asarray((solutions.state == NO_STATE).all(axis=1), bool)
    for k, status in enumerate(solutions.status):
        claims_placement = status in ("optimal", "feasible")
        if placed[k]:
            is_complete = is_state[k] and 0 <= solutions.slot[k] <= scenes.count
            is_complete = is_complete and math.isfinite(solutions.objective[k])
        else:
            is_complete = has_no_pose[k] and no_state[k] and solutions.slot[k] == NO_STATE
            is_complete = (
                is_complete
                and solutions.objective[k] == math.inf
                and bool(np.isnan(solutions.overlap[k]))
            )
        if claims_placement != placed[k] or not is_complete:
            what = f"status {status}, pose {'there' if placed[k] else 'missing'}"
            yield f"scene {k}: {what}" if has_many else what


def _check_scenes(plan: ShelfPlan, solver: ShelfSolverSpec | None) -> Iterator[Check]:
    """Check costs, overlaps, slots, bounds and statuses of all scenes."""
    solutions, scenes = plan.solutions, plan.scenes
    placed = solutions.placed
    cost = compute_movement_cost(scenes, solutions.pose)
    relative_error = np.abs(solutions.objective - cost) / np.maximum(1.0, cost)
    yield _check_worst_scene("file.objective", relative_error, placed)
    depth = measure_worst_overlap(scenes, solutions.pose)
    yield _check_worst_scene("solution.overlap", np.abs(solutions.overlap - depth), placed)
    is_wrong_slot = (solutions.slot != find_slots(solutions.pose, scenes.sizes)).astype(float)
    yield _check_worst_scene("solution.slot", is_wrong_slot, placed)
    yield _check_worst_scene("solution.bound", solutions.bound - solutions.objective, placed)
    optimal = np.array([status == "optimal" for status in solutions.status])
    if solver is not None:
        allowed = np.maximum(solver.gap_mm2, solver.gap * solutions.objective)
        gap = solutions.objective - solutions.bound - allowed * (1 + 1e-6)
        yield _check_worst_scene("solution.gap", gap, placed & optimal)
    infeasible = np.array([status == "infeasible" for status in solutions.status])
    if plan.meaning == "contact":
        fits = fit_side_by_side(scenes, plan.shelf).astype(float)
        yield _check_worst_scene("solution.infeasible", fits, infeasible)


def _build_constraint_check(item: NamedResidual, scenes: NDArray[np.intp], total: int) -> Check:
    """Build the check of one constraint from its worst scene."""
    severity = item.severity
    worst = int(np.argmax(severity))
    residual = float(item.residual[worst])
    place = f"scene {scenes[worst]}, {item.place[worst]}" if total > 1 else item.place[worst]
    # 1 at the limit and towards 0 with a larger margin: orders constraints by how near they are.
    passed = bool(item.passed.all())
    utilisation = item.limit / (2 * item.limit - residual) if passed and item.limit > 0 else 1.0
    unit = f" {item.unit}" if item.unit else ""
    margin = f"{residual:.2g} of {item.limit:g}{unit}" if residual > 0 else ""
    return Check(item.name, residual, item.limit, item.unit, passed, margin, place, utilisation)


def _check_worst_scene(name: str, residuals: Array, rows: BoolArray) -> Check:
    """Build the check of the worst scene among `rows`; NaN is worse than every number."""
    scenes = np.flatnonzero(rows)
    if len(scenes) == 0:
        return _compare_with_limit(name, 0.0)
    values = np.where(np.isnan(residuals[scenes]), np.inf, residuals[scenes])
    worst = int(np.argmax(values))
    return _compare_with_limit(
        name, float(values[worst]), f"scene {scenes[worst]}" if len(rows) > 1 else ""
    )


def _check_fault_count(name: str, faults: tuple[str, ...] | list[str]) -> Check:
    return _compare_with_limit(name, float(len(faults)), faults[0] if faults else "")


def _compare_with_limit(name: str, residual: float, worst_at: str = "") -> Check:
    limit = LIMITS[name]
    residual += 0.0  # no minus zero
    passed = bool(residual <= limit.value)  # False for NaN
    return Check(
        name, residual, limit.value, limit.unit, passed, "", worst_at if residual > 0 else ""
    )


def _select_scenes(scenes: Scenes, rows: BoolArray) -> Scenes:
    return Scenes(scenes.pose[rows], scenes.size[rows], scenes.inserted[rows])
