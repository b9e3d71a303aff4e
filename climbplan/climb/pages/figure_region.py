"""Where the task can be done: labels over a grid of one or two spec values (as in Fig. 5.7)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from climbplan.climb.pages.study_grid import StudyAxis, build_study_axes, compute_cell_edges
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    format_plain,
    new_figure,
    style_axes,
)

# A second mark beside colour: none, hatched, cross-hatched.
_HATCHES = ("", "//", "xx")


def region(plan: ClimbPlan) -> Figure:
    """Return labels of a plan's study. Raises ValueError if the plan has none."""
    if plan.study is None:
        raise ValueError("the plan has no study")
    study, axes = plan.study, build_study_axes(plan, plan.study)
    flat = len(axes) == 1
    figure = new_figure(2.6 if flat else 6.4, entries=4)
    ax = figure.subplots()
    style_axes(ax)
    _draw_cells(ax, study, axes)
    ax.grid(visible=False)
    ax.set_xlabel(format_plain(axes[0].label))
    if flat:
        ax.set_yticks([])
    else:
        ax.set_ylabel(format_plain(axes[1].label))
    handles: list[Patch | Line2D] = [
        Patch(facecolor=color, hatch=hatch, edgecolor="white", lw=0)
        for color, hatch in zip(palette.LABELS, _HATCHES, strict=True)
    ]
    names = [
        f"{name} ({int(np.count_nonzero(study.label == i))})" for i, name in enumerate(Study.LABELS)
    ]
    if _mark_plan(ax, axes):
        handles.append(Line2D([], [], ls="", marker="*", ms=13, mfc="white", mec=palette.INK))
        names.append("this plan")
    draw_foot_legend(figure, handles, names)
    note = format_plain(f"{plan.name}, {plan.robot.name}, {study.label.size} grid points")
    draw_heading(figure, "Feasible region", note)
    return figure


def _draw_cells(ax: Axes, study: Study, axes: tuple[StudyAxis, ...]) -> None:
    """One coloured and hatched cell a grid point, in ascending order of the values."""
    order = [np.argsort(axis.values) for axis in axes]
    label = study.label[order[0]]
    x = compute_cell_edges(axes[0].values[order[0]])
    y = np.array([0.0, 1.0])
    if len(axes) == 2:
        label = label[:, order[1]]
        y = compute_cell_edges(axes[1].values[order[1]])
    count = len(Study.LABELS)
    ax.pcolormesh(
        x,
        y,
        label.T,
        cmap=ListedColormap(palette.LABELS),
        norm=BoundaryNorm(np.arange(count + 1) - 0.5, count),
        edgecolors="white",
        linewidth=0.8,
    )
    for index, hatch in enumerate(_HATCHES):
        if not hatch:
            continue
        for i, j in np.argwhere(label == index):
            corner = (float(x[i]), float(y[j]))
            size = float(x[i + 1] - x[i]), float(y[j + 1] - y[j])
            ax.add_patch(Rectangle(corner, *size, fill=False, hatch=hatch, ec="white", lw=0))


def _mark_plan(ax: Axes, axes: tuple[StudyAxis, ...]) -> bool:
    """Mark the plan's own values; False if they are unknown or off the picture."""
    plan_values = [axis.own for axis in axes]
    x, y = plan_values[0], 0.5 if len(axes) == 1 else plan_values[1]
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    if x is None or y is None or not (left <= x <= right and low <= y <= high):
        return False
    ax.plot([x], [y], ls="", marker="*", ms=15, mfc="white", mec=palette.INK, zorder=5)
    return True
