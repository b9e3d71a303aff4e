"""Figures of a bookshelf plan: the scene, galleries of the costliest, and statistics."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from climbplan.bookshelf.pages.pictures import ScenePicture, draw_gallery, draw_scene
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.plan.summary import TRIVIAL, Spread, select_nontrivial_costs
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)

COLUMNS = 5
_STATUS_COLORS = {
    "optimal": "#4DA37F",
    "feasible": "#56B4E9",
    "infeasible": "#8C5FA8",
    "limit": palette.FAILURE,
}
_LEAST_COST = 1e-3  # [mm^2] left end of the cost axis; what costs less stands there


def draw_single_scene(plan: ShelfPlan) -> Figure:
    """Draw the only scene before and after the insertion."""
    title = plan.title or plan.name
    return draw_scene(_build_picture(plan, 0, format_plain(title).replace(r"\$", "$")), plan.shelf)


def draw_gallery_page(plan: ShelfPlan, scenes: list[int]) -> Figure:
    """Draw scenes before and after the insertion, on one page."""
    items = [_build_picture(plan, k, f"scene {k}") for k in scenes]
    has_unplaced = not plan.solutions.placed[scenes].all()
    if has_unplaced:
        description = "scenes without a placement, and the costliest"
    elif (plan.solutions.objective[scenes] > TRIVIAL).any():
        description = f"the costliest scenes, above {TRIVIAL:g} mm²"
    else:
        description = f"no scene costs more than {TRIVIAL:g} mm²; some of them"
    name = format_plain(plan.title or plan.name).replace(r"\$", "$")
    return draw_gallery(items, plan.shelf, COLUMNS, f"{name}: {description}")


def _build_picture(plan: ShelfPlan, k: int, title: str) -> ScenePicture:
    solutions = plan.solutions
    if not solutions.placed[k]:
        text = solutions.message[k] if solutions.status[k] == "infeasible" else "no answer"
        return ScenePicture(plan.scenes[k], None, format_plain(text, 34).replace(r"\$", "$"), title)
    text = f"{solutions.objective[k]:.2f} mm²"
    if solutions.status[k] != "optimal" and np.isfinite(solutions.bound[k]):
        text += f", at least {solutions.bound[k]:.2f}"
    return ScenePicture(plan.scenes[k], solutions.placement(k), text, title)


def draw_statistics(plan: ShelfPlan) -> Figure:
    """Draw the statistics of outcomes, times and costs."""
    figure = new_figure(4.4, entries=len(_STATUS_COLORS))
    left, middle, right = figure.subplots(1, 3, width_ratios=(0.7, 1.2, 1.2))
    _plot_outcomes(left, plan)
    _plot_times(middle, plan)
    _plot_costs(right, plan)
    handles = [
        Line2D([], [], ls="", marker="s", ms=8, color=color) for color in _STATUS_COLORS.values()
    ]
    draw_foot_legend(
        figure, handles, ["optimal (proved)", "feasible", "proved infeasible", "no answer"]
    )
    note = format_plain(f"{plan.name}, method {plan.method}, formulation {plan.meaning}")
    draw_heading(figure, f"{len(plan.scenes)} scenes", note)
    return figure


def _plot_outcomes(ax: Axes, plan: ShelfPlan) -> None:
    counts = [plan.solutions.count(status) for status in _STATUS_COLORS]
    bars = ax.bar(range(len(counts)), counts, color=list(_STATUS_COLORS.values()), width=0.7)
    ax.bar_label(bars, fontsize=9, color=palette.INK)
    style_axes(ax)
    ax.set_xticks([])
    ax.set_ylabel("scenes")
    ax.set_ylim(0, 1.12 * max(counts))
    placed_percent = 100 * plan.solutions.placed.mean()
    draw_panel_title(ax, "Outcome", f"{placed_percent:.1f} % placed")


def _plot_times(ax: Axes, plan: ShelfPlan) -> None:
    """Plot the histogram of the solution times, stacked by status."""
    time = np.maximum(1e3 * plan.solutions.time, 1e-3)
    _plot_stacked_histogram(ax, plan, time, np.ones(len(time), bool))
    spread = Spread.of(time)
    for value, style in ((spread.median, "-"), (spread.most99, "--")):
        ax.axvline(value, color=palette.INK, lw=1.1, ls=style)
    ax.set_xlabel("time of a scene [ms] (lines: median, 99 %)")
    note = f"median {spread.median:.2g}, 99 % {spread.most99:.3g}, worst {spread.largest:.3g} ms"
    draw_panel_title(ax, "Time", note)


def _plot_costs(ax: Axes, plan: ShelfPlan) -> None:
    """Plot the histogram of the movement costs with the trivial part shaded."""
    placed = plan.solutions.placed
    if not placed.any():
        style_axes(ax)
        draw_panel_title(ax, "Movement cost", "no placement")
        return
    cost = np.maximum(plan.solutions.objective, _LEAST_COST)
    _plot_stacked_histogram(ax, plan, cost, placed)
    first, last = ax.get_xlim()
    ax.set_xlim(first, last)
    ax.axvspan(first, max(first, TRIVIAL), color=palette.GRID, alpha=0.5, lw=0, zorder=0.5)
    ax.set_xlabel(f"movement cost [mm²] (shaded: at most {TRIVIAL:g})")
    nontrivial_percent = 100 * len(select_nontrivial_costs(plan.solutions)) / int(placed.sum())
    draw_panel_title(ax, "Movement cost", f"{nontrivial_percent:.1f} % above {TRIVIAL:g} mm²")


def _plot_stacked_histogram(
    ax: Axes, plan: ShelfPlan, values: np.ndarray, rows: np.ndarray
) -> None:
    """Plot the histogram of values (S,) of the scenes `rows` on a logarithmic axis."""
    low, high = float(values[rows].min()), float(values[rows].max())
    high = max(high, 2 * low)
    edges = np.geomspace(low / 1.0001, high * 1.0001, 31)
    status = np.array(plan.solutions.status)
    groups = [values[rows & (status == name)] for name in _STATUS_COLORS]
    ax.hist(groups, bins=list(edges), stacked=True, color=list(_STATUS_COLORS.values()))
    ax.set_xscale("log")
    style_axes(ax)
    ax.set_ylabel("scenes")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if high < 200 * low else (1.0,)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _format_axis_label(value)))
    ax.xaxis.set_minor_formatter(NullFormatter())


def _format_axis_label(value: float) -> str:
    """Format a number; the first of the cost axis represents all values below it."""
    return f"≤ {value:g}" if value == _LEAST_COST else f"{value:g}"
