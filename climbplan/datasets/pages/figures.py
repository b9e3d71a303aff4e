"""Figures of a dataset: outcomes, times and costs; of books also their states and a gallery."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.bookshelf.pages.figures import list_gallery_pages
from climbplan.bookshelf.pages.pictures import infer_states
from climbplan.bookshelf.plan.dataset_frame import KIND, read_shelf_dataset
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.scene.shelf_scene import BookState
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)
from climbplan.reports.unit_words import format_units
from climbplan.store.dataset import Dataset

COLORS = {
    "optimal": "#4DA37F",
    "feasible": "#56B4E9",
    "infeasible": "#8C5FA8",
    "limit": "#E0A03A",
    "failed": palette.FAILURE,
}
_WORDS = ("optimal (proved)", "feasible", "proved infeasible", "limit reached", "failed")
_BINS = 30


def select_figures(data: Dataset) -> Mapping[str, Callable[[], Figure]]:
    """Return the figures of a dataset by file name."""
    figures: dict[str, Callable[[], Figure]] = {"statistics": partial(draw_statistics, data)}
    if data.frame.kind == KIND and data.drawn.any():
        plan = read_shelf_dataset(data).plan
        figures["states"] = partial(draw_states, plan)
        figures |= {name: partial(draw, plan) for name, draw in list_gallery_pages(plan).items()}
    return figures


def draw_statistics(data: Dataset) -> Figure:
    """Return how the rows ended, how long they took and what they cost."""
    figure = new_figure(4.4, entries=len(COLORS))
    left, middle, right = figure.subplots(1, 3, width_ratios=(0.7, 1.2, 1.2))
    counts = [data.statuses.get(status, 0) for status in COLORS]
    bars = left.bar(range(len(counts)), counts, color=list(COLORS.values()), width=0.7)
    left.bar_label(bars, fontsize=9, color=palette.INK)
    style_axes(left)
    left.set_xticks([])
    left.set_ylabel("rows")
    left.set_ylim(0, 1.12 * max(counts))
    draw_panel_title(left, "Outcome", f"{100 * data.feasible.mean():.1f} % answered")
    time = np.maximum(1e3 * data.time, 1e-3)
    _draw_stacked_histogram(middle, data, time, np.ones(data.count, bool), logarithmic=True)
    middle.set_xlabel("solver's time of a row [ms]")
    draw_panel_title(middle, "Time", f"median {np.median(time):.3g} ms, worst {time.max():.3g} ms")
    cost = data.objective
    unit = f" [{format_units(data.frame.objective_unit)}]" if data.frame.objective_unit else ""
    min_cost = float(cost[data.feasible].min()) if data.feasible.any() else 0.0
    costs_shown = np.maximum(cost, 1e-3) if min_cost >= 0 else cost
    _draw_stacked_histogram(right, data, costs_shown, data.feasible, logarithmic=min_cost >= 0)
    right.set_xlabel(f"cost{unit}")
    middle_cost = f"median {np.median(cost[data.feasible]):.4g}" if data.feasible.any() else "none"
    draw_panel_title(right, "Cost", middle_cost)
    handles = [Line2D([], [], ls="", marker="s", ms=8, color=color) for color in COLORS.values()]
    draw_foot_legend(figure, handles, _WORDS)
    draw_heading(
        figure, f"{data.count} rows", format_plain(f"{data.name}, problem {data.frame.problem}")
    )
    return figure


def draw_states(plan: ShelfPlan) -> Figure:
    """Return how books stand before and after, and how scenes are made up."""
    figure = new_figure(4.4, entries=2)
    left, middle, right = figure.subplots(1, 3)
    before = np.concatenate([infer_states(scene.pose[:, 2]) for scene in plan.scenes])
    placed = plan.solutions.placed
    after = plan.solutions.state[placed, :-1].ravel()
    inserted = plan.solutions.state[placed, -1]
    groups = ((before, palette.MUTED), (after, COLORS["optimal"]), (inserted, palette.LIMBS[1]))
    for k, (values, color) in enumerate(groups):
        fraction = (
            np.mean(values[:, None] == np.arange(len(BookState)), axis=0) if len(values) else 0.0
        )
        left.bar(
            np.arange(len(BookState)) + 0.27 * (k - 1),
            100.0 * np.broadcast_to(fraction, len(BookState)),
            width=0.25,
            color=color,
        )
    left.set_xticks(range(len(BookState)), [state.label.replace(" ", "\n") for state in BookState])
    style_axes(left)
    left.set_ylabel("books [%]")
    draw_panel_title(left, "States", f"{len(plan.scenes)} scenes")
    tilt = np.degrees(plan.scenes.pose[..., 2].ravel())
    middle.hist(tilt, bins=np.linspace(-95, 95, 39).tolist(), color=palette.MUTED)
    middle.set_yscale("log")
    style_axes(middle)
    middle.set_xlabel("angle of a stored book before [deg]")
    draw_panel_title(middle, "Angles before")
    sizes = 1e3 * plan.scenes.size.reshape(-1, 2)
    right.hist(1e3 * plan.scenes.inserted[:, 1], bins=_BINS, color=palette.LIMBS[1], alpha=0.6)
    right.hist(sizes[:, 1], bins=_BINS, color=palette.MUTED, alpha=0.6)
    style_axes(right)
    right.set_xlabel("width [mm]")
    draw_panel_title(right, "Widths")
    handles = [Line2D([], [], ls="", marker="s", ms=8, color=color) for _, color in groups]
    draw_foot_legend(figure, handles, ("stored, before", "stored, after", "inserted"))
    draw_heading(figure, "Scenes", format_plain(plan.name))
    return figure


def _draw_stacked_histogram(
    ax: Axes, data: Dataset, values: Array, rows: np.ndarray, *, logarithmic: bool
) -> None:
    """Draw a histogram of values (n,) of the chosen rows, stacked by status."""
    style_axes(ax)
    ax.set_ylabel("rows")
    if not rows.any():
        return
    low, high = float(values[rows].min()), float(values[rows].max())
    if logarithmic:
        edges = np.geomspace(low / 1.0001, max(high, 2 * low) * 1.0001, _BINS + 1)
        ax.set_xscale("log")
    else:
        padding = 1e-9 + 0.01 * max(high - low, abs(high), 1e-6)
        edges = np.linspace(low - padding, high + padding, _BINS + 1)
    status = np.array(data.status)
    groups = [values[rows & (status == name)] for name in COLORS]
    ax.hist(groups, bins=list(edges), stacked=True, color=list(COLORS.values()))
