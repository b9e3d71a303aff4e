"""The key figures of a bookshelf plan: success, times and costs over the scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.plan.summary import TRIVIAL, Spread, select_nontrivial_costs
from climbplan.bookshelf.scene.shelf_scene import state_label
from climbplan.reports.plan_report import FigureOf

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LISTED = 40  # scenes listed one by one
PER_PAGE = 20  # scenes in a gallery

# Unit of every number in the report, by dotted key; what is not listed is a pure number.
UNITS = {
    "objective": "mm^2",
    "bound": "mm^2",
    "gap": "mm^2",
    "timings.*": "s",
    "time.*": "s",
    "cost.*": "mm^2",
    "shelf.*": "m",
    "costliest.*.objective": "mm^2",
    "costliest.*.bound": "mm^2",
    "costliest.*.time": "s",
    "without_placement.*.time": "s",
    "books.*.before": "m, m, rad",
    "books.*.after": "m, m, rad",
    "books.*.size": "m",
}


def compute_key_figures(plan: ShelfPlan) -> dict[str, Any]:
    """Compute counts, statistics of time and cost, and entries of the most important scenes."""
    solutions = plan.solutions
    placed = solutions.placed
    cost, moving = solutions.objective[placed], select_nontrivial_costs(solutions)
    figures: dict[str, Any] = {
        "scenes": {
            "total": len(plan.scenes),
            "stored_books": plan.scenes.count,
            **{status: solutions.count(status) for status in ("optimal", "feasible")},
            **{status: solutions.count(status) for status in ("infeasible", "limit")},
            "nontrivial": len(moving),
        },
        "time": asdict(Spread.of(solutions.time)),
        "cost": {
            "all": asdict(Spread.of(cost)),
            "nontrivial": asdict(Spread.of(moving)),
            "nontrivial_above": TRIVIAL,
        },
        "overlap": float(solutions.overlap[placed].max()) if placed.any() else None,
        "shelf": {name: vars(plan.shelf)[name] for name in ("left", "right", "height")},
        "costliest": [build_scene_entry(plan, k) for k in rank_costliest(plan)],
        "without_placement": [
            build_scene_entry(plan, int(k)) for k in np.flatnonzero(~placed)[:LISTED]
        ],
    }
    if len(plan.scenes) == 1:
        figures["books"] = _list_books(plan)
    return figures


def rank_costliest(plan: ShelfPlan, max_count: int = LISTED) -> list[int]:
    """Rank the scenes with a placement by cost, the costliest first."""
    cost = np.where(plan.solutions.placed, plan.solutions.objective, -math.inf)
    order = np.argsort(-cost, kind="stable")
    return [int(k) for k in order[:max_count] if plan.solutions.placed[k]]


def build_scene_entry(plan: ShelfPlan, k: int) -> dict[str, Any]:
    """Build the entry of one scene in a list."""
    solutions = plan.solutions
    return {
        "scene": k,
        "status": solutions.status[k],
        "objective": float(solutions.objective[k]),
        "bound": float(solutions.bound[k]),
        "time": float(solutions.time[k]),
        "slot": int(solutions.slot[k]),
        "message": solutions.message[k],
    }


def _list_books(plan: ShelfPlan) -> list[dict[str, Any]]:
    """List the poses of each book of the only scene before and after the insertion."""
    solutions, scene = plan.solutions, plan.scenes[0]
    entries = []
    for book in range(scene.count + 1):
        stored = book < scene.count
        placed = bool(solutions.placed[0])
        entries.append(
            {
                "book": str(book) if stored else "inserted",
                "size": scene.sizes[book].tolist(),
                "before": scene.pose[book].tolist() if stored else None,
                "after": solutions.pose[0, book].tolist() if placed else None,
                "state": state_label(int(solutions.state[0, book])) if placed else None,
            }
        )
    return entries


def list_gallery_pages(plan: ShelfPlan) -> Mapping[str, Callable[[ShelfPlan], Figure]]:
    """List pages of scenes by figure name: those without a placement, then the costliest.

    Scenes that need almost no movement (`TRIVIAL`) appear only if there are no others.
    """
    missing = [int(k) for k in np.flatnonzero(~plan.solutions.placed)]
    listed = rank_costliest(plan)
    costly = [k for k in listed if plan.solutions.objective[k] > TRIVIAL]
    scenes = (missing[: PER_PAGE // 2] + costly)[:LISTED] or listed[:PER_PAGE]
    pages = [scenes[k : k + PER_PAGE] for k in range(0, len(scenes), PER_PAGE)]
    draw = FigureOf("climbplan.bookshelf.pages.figure_shelf:draw_gallery_page")
    return {f"gallery_{n}": partial(draw, scenes=page) for n, page in enumerate(pages, start=1)}
