"""Figures of a bookshelf plan: the scene, galleries of the costliest, and statistics."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from climbplan.bookshelf.pages.pictures import Pictured, gallery, scene_figure
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.plan.summary import TRIVIAL, Spread, nontrivial
from climbplan.reports import palette
from climbplan.reports.sheet import (
    foot_legend,
    heading,
    new_figure,
    panel_title,
    plain,
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


def the_scene(plan: ShelfPlan) -> Figure:
    """Before and after of the only scene."""
    title = plan.title or plan.name
    return scene_figure(_pictured(plan, 0, plain(title).replace(r"\$", "$")), plan.shelf)


def scene_gallery(plan: ShelfPlan, scenes: list[int]) -> Figure:
    """Before and after of these scenes, on one page."""
    items = [_pictured(plan, k, f"scene {k}") for k in scenes]
    lost = not plan.solutions.placed[scenes].all()
    if lost:
        what = "scenes without a placement, and the costliest"
    elif (plan.solutions.objective[scenes] > TRIVIAL).any():
        what = f"the costliest scenes, above {TRIVIAL:g} mm²"
    else:
        what = f"no scene costs more than {TRIVIAL:g} mm²; some of them"
    name = plain(plan.title or plan.name).replace(r"\$", "$")
    return gallery(items, plan.shelf, COLUMNS, f"{name}: {what}")


def _pictured(plan: ShelfPlan, k: int, title: str) -> Pictured:
    found = plan.solutions
    if not found.placed[k]:
        text = found.message[k] if found.status[k] == "infeasible" else "no answer"
        return Pictured(plan.scenes[k], None, plain(text, 34).replace(r"\$", "$"), title)
    text = f"{found.objective[k]:.2f} mm²"
    if found.status[k] != "optimal" and np.isfinite(found.bound[k]):
        text += f", at least {found.bound[k]:.2f}"
    return Pictured(plan.scenes[k], found.placement(k), text, title)


def statistics(plan: ShelfPlan) -> Figure:
    """How the scenes ended, how long they took and what they cost."""
    figure = new_figure(4.4, entries=len(_STATUS_COLORS))
    left, middle, right = figure.subplots(1, 3, width_ratios=(0.7, 1.2, 1.2))
    _outcomes(left, plan)
    _times(middle, plan)
    _costs(right, plan)
    handles = [
        Line2D([], [], ls="", marker="s", ms=8, color=color) for color in _STATUS_COLORS.values()
    ]
    foot_legend(figure, handles, ["optimal (proved)", "feasible", "proved infeasible", "no answer"])
    note = plain(f"{plan.name}, method {plan.method}, meaning {plan.meaning}")
    heading(figure, f"{len(plan.scenes)} scenes", note)
    return figure


def _outcomes(ax: Axes, plan: ShelfPlan) -> None:
    counts = [plan.solutions.count(status) for status in _STATUS_COLORS]
    bars = ax.bar(range(len(counts)), counts, color=list(_STATUS_COLORS.values()), width=0.7)
    ax.bar_label(bars, fontsize=9, color=palette.INK)
    style_axes(ax)
    ax.set_xticks([])
    ax.set_ylabel("scenes")
    ax.set_ylim(0, 1.12 * max(counts))
    share = 100 * plan.solutions.placed.mean()
    panel_title(ax, "Outcome", f"{share:.1f} % placed")


def _times(ax: Axes, plan: ShelfPlan) -> None:
    """Histogram of the solution times, stacked by status."""
    time = np.maximum(1e3 * plan.solutions.time, 1e-3)
    _stacked(ax, plan, time, np.ones(len(time), bool))
    spread = Spread.of(time)
    for value, style in ((spread.median, "-"), (spread.most99, "--")):
        ax.axvline(value, color=palette.INK, lw=1.1, ls=style)
    ax.set_xlabel("time of a scene [ms] (lines: median, 99 %)")
    note = f"median {spread.median:.2g}, 99 % {spread.most99:.3g}, worst {spread.largest:.3g} ms"
    panel_title(ax, "Time", note)


def _costs(ax: Axes, plan: ShelfPlan) -> None:
    """Histogram of the movement costs with the trivial share."""
    placed = plan.solutions.placed
    if not placed.any():
        style_axes(ax)
        panel_title(ax, "Movement cost", "no placement")
        return
    cost = np.maximum(plan.solutions.objective, _LEAST_COST)
    _stacked(ax, plan, cost, placed)
    first, last = ax.get_xlim()
    ax.set_xlim(first, last)
    ax.axvspan(first, max(first, TRIVIAL), color=palette.GRID, alpha=0.5, lw=0, zorder=0.5)
    ax.set_xlabel(f"movement cost [mm²] (shaded: at most {TRIVIAL:g})")
    share = 100 * len(nontrivial(plan.solutions)) / int(placed.sum())
    panel_title(ax, "Movement cost", f"{share:.1f} % above {TRIVIAL:g} mm²")


def _stacked(ax: Axes, plan: ShelfPlan, values: np.ndarray, rows: np.ndarray) -> None:
    """Histogram of values (S,) of the scenes `rows` on a logarithmic axis."""
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
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _axis_label(value)))
    ax.xaxis.set_minor_formatter(NullFormatter())


def _axis_label(value: float) -> str:
    """A number as people write it; the first of the cost axis stands for all below."""
    return f"≤ {value:g}" if value == _LEAST_COST else f"{value:g}"
