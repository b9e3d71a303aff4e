"""How far the two blocks of a consensus are apart, iteration by iteration (as in Fig. 6.4)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from climbplan.limms.plan.convergence import Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports import palette
from climbplan.reports.sheet import foot_legend, heading, new_figure, panel_title, plain, style_axes

_NAMES = {"box": "box, r_pB", "points": "modules, r_pL", "axes": "frames, r_RL"}
_LEAST = 1e-6  # [m], [rad] what is drawn at least: the scale is logarithmic


def convergence(plan: LimmsPlan) -> Figure:
    """Mean and largest residuals by iteration; positions left, frames right.

    The plan must have a record of its consensus.
    """
    record = plan.convergence
    assert record is not None
    figure = new_figure(4.2, entries=len(_NAMES) + 4)
    tried = int(record.attempt[-1]) + 1
    note = f"{len(record.attempt)} iterations" + (
        f", {tried} choices of modes" if tried > 1 else ""
    )
    heading(figure, plain(plan.title or plan.name), note)
    left, right = figure.subplots(1, 2)
    colors = dict(zip(_NAMES, palette.LIMBS, strict=False))
    for ax, names, limit in ((left, ("box", "points"), 0.01), (right, ("axes",), 0.1)):
        for name in names:
            _lines(ax, record, name, colors[name])
        ax.axhline(limit, color=palette.REQUIRED, linewidth=0.9, linestyle=":")
        _style(ax, record)
    left.set_ylabel("positions apart [m]")
    right.set_ylabel("frames apart [rad]")
    panel_title(left, "Positions", "dots: 1 cm")
    panel_title(right, "Frames", "dots: 0.1 rad")
    handles = [Line2D([], [], color=color, linewidth=1.6) for color in colors.values()]
    handles += [
        Line2D([], [], color=palette.MUTED, linewidth=1.6),
        Line2D([], [], color=palette.MUTED, linewidth=1.2, linestyle="--"),
    ]
    foot_legend(figure, handles, [*_NAMES.values(), "mean", "largest"])
    return figure


def _lines(ax: Axes, record: Convergence, name: str, color: str) -> None:
    """Each choice of modes for itself."""
    number = np.arange(1, len(record.attempt) + 1)
    for attempt in np.unique(record.attempt):
        at = record.attempt == attempt
        for part, style, width in (("mean", "-", 1.6), ("max", "--", 1.2)):
            values = np.maximum(vars(record)[f"{name}_{part}"][at], _LEAST)
            ax.plot(number[at], values, style, color=color, linewidth=width, marker=".")


def _style(ax: Axes, record: Convergence) -> None:
    ax.set_yscale("log")
    ax.set_xlabel("iteration")
    ax.set_xlim(0.5, len(record.attempt) + 0.5)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    free = np.flatnonzero(record.frozen == 0) + 1
    for number in free[1:]:
        ax.axvspan(number - 0.5, number + 0.5, color=palette.GRID, alpha=0.4, linewidth=0)
    style_axes(ax)
