"""Figure of consensus residuals by iteration (as in Fig. 6.4)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from climbplan.limms.plan.convergence import Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)

_NAMES = {"box": "box, r_pB", "points": "modules, r_pL", "axes": "frames, r_RL"}
_MIN_VALUE = 1e-6  # [m], [rad], smallest value on the logarithmic scale


def plot_convergence(plan: LimmsPlan) -> Figure:
    """Plot mean and largest residuals by iteration; positions left, frames right.

    The plan must have a record of its consensus.
    """
    record = plan.convergence
    assert record is not None
    figure = new_figure(4.2, entries=len(_NAMES) + 4)
    tried = int(record.attempt[-1]) + 1
    note = f"{len(record.attempt)} iterations" + (
        f", {tried} choices of modes" if tried > 1 else ""
    )
    draw_heading(figure, format_plain(plan.title or plan.name), note)
    left, right = figure.subplots(1, 2)
    colors = dict(zip(_NAMES, palette.LIMBS, strict=False))
    for ax, names, limit in ((left, ("box", "points"), 0.01), (right, ("axes",), 0.1)):
        for name in names:
            _plot_lines(ax, record, name, colors[name])
        ax.axhline(limit, color=palette.REQUIRED, linewidth=0.9, linestyle=":")
        _style_axes(ax, record)
    left.set_ylabel("positions apart [m]")
    right.set_ylabel("frames apart [rad]")
    draw_panel_title(left, "Positions", "dots: 1 cm")
    draw_panel_title(right, "Frames", "dots: 0.1 rad")
    handles = [Line2D([], [], color=color, linewidth=1.6) for color in colors.values()]
    handles += [
        Line2D([], [], color=palette.MUTED, linewidth=1.6),
        Line2D([], [], color=palette.MUTED, linewidth=1.2, linestyle="--"),
    ]
    draw_foot_legend(figure, handles, [*_NAMES.values(), "mean", "largest"])
    return figure


def _plot_lines(ax: Axes, record: Convergence, name: str, color: str) -> None:
    """Plot the residuals of each choice of modes separately."""
    number = np.arange(1, len(record.attempt) + 1)
    for attempt in np.unique(record.attempt):
        in_attempt = record.attempt == attempt
        for statistic, style, width in (("mean", "-", 1.6), ("max", "--", 1.2)):
            values = np.maximum(vars(record)[f"{name}_{statistic}"][in_attempt], _MIN_VALUE)
            ax.plot(number[in_attempt], values, style, color=color, linewidth=width, marker=".")


def _style_axes(ax: Axes, record: Convergence) -> None:
    """Style the axes, with iterations of free integers shaded."""
    ax.set_yscale("log")
    ax.set_xlabel("iteration")
    ax.set_xlim(0.5, len(record.attempt) + 0.5)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    free = np.flatnonzero(record.frozen == 0) + 1
    for number in free[1:]:
        ax.axvspan(number - 0.5, number + 0.5, color=palette.GRID, alpha=0.4, linewidth=0)
    style_axes(ax)
