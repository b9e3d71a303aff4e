"""The key figures of a bookshelf plan: success, times and costs over the scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.plan.summary import TRIVIAL, Spread, nontrivial
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


def key_figures(plan: ShelfPlan) -> dict[str, Any]:
    """Counts, spreads of time and cost, and scenes one by one as far as they matter."""
    found = plan.solutions
    placed = found.placed
    cost, moving = found.objective[placed], nontrivial(found)
    figures: dict[str, Any] = {
        "scenes": {
            "total": len(plan.scenes),
            "stored_books": plan.scenes.count,
            **{status: found.count(status) for status in ("optimal", "feasible")},
            **{status: found.count(status) for status in ("infeasible", "limit")},
            "nontrivial": len(moving),
        },
        "time": asdict(Spread.of(found.time)),
        "cost": {
            "all": asdict(Spread.of(cost)),
            "nontrivial": asdict(Spread.of(moving)),
            "nontrivial_above": TRIVIAL,
        },
        "overlap": float(found.overlap[placed].max()) if placed.any() else None,
        "shelf": {name: vars(plan.shelf)[name] for name in ("left", "right", "height")},
        "costliest": [scene_entry(plan, k) for k in costliest(plan)],
        "without_placement": [scene_entry(plan, int(k)) for k in np.flatnonzero(~placed)[:LISTED]],
    }
    if len(plan.scenes) == 1:
        figures["books"] = _books(plan)
    return figures


def costliest(plan: ShelfPlan, most: int = LISTED) -> list[int]:
    """Scenes with a placement, the costliest first."""
    cost = np.where(plan.solutions.placed, plan.solutions.objective, -math.inf)
    order = np.argsort(-cost, kind="stable")
    return [int(k) for k in order[:most] if plan.solutions.placed[k]]


def scene_entry(plan: ShelfPlan, k: int) -> dict[str, Any]:
    """One scene in a list."""
    found = plan.solutions
    return {
        "scene": k,
        "status": found.status[k],
        "objective": float(found.objective[k]),
        "bound": float(found.bound[k]),
        "time": float(found.time[k]),
        "slot": int(found.slot[k]),
        "message": found.message[k],
    }


def _books(plan: ShelfPlan) -> list[dict[str, Any]]:
    """What happens to each book of the only scene."""
    found, scene = plan.solutions, plan.scenes[0]
    entries = []
    for book in range(scene.count + 1):
        stored = book < scene.count
        placed = bool(found.placed[0])
        entries.append(
            {
                "book": str(book) if stored else "inserted",
                "size": scene.sizes[book].tolist(),
                "before": scene.pose[book].tolist() if stored else None,
                "after": found.pose[0, book].tolist() if placed else None,
                "state": state_label(int(found.state[0, book])) if placed else None,
            }
        )
    return entries


def gallery_pages(plan: ShelfPlan) -> Mapping[str, Callable[[ShelfPlan], Figure]]:
    """Pages of scenes, by figure name: without a placement, then the costliest.

    Scenes that need next to no movement (`TRIVIAL`) are shown only where no other is.
    """
    missing = [int(k) for k in np.flatnonzero(~plan.solutions.placed)]
    listed = costliest(plan)
    costly = [k for k in listed if plan.solutions.objective[k] > TRIVIAL]
    shown = (missing[: PER_PAGE // 2] + costly)[:LISTED] or listed[:PER_PAGE]
    pages = [shown[k : k + PER_PAGE] for k in range(0, len(shown), PER_PAGE)]
    draw = FigureOf("climbplan.bookshelf.pages.figure_shelf:scene_gallery")
    return {f"gallery_{n}": partial(draw, scenes=page) for n, page in enumerate(pages, start=1)}
