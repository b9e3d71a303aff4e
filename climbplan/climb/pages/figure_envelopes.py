"""Figures of fitted envelopes: boxes with the data behind them, fitness over generations."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from climbplan.arrays import Array
from climbplan.climb.envelopes.run import EnvelopeRun
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_limb_name,
    format_plain,
    new_figure,
    style_axes,
)

# Of each limb: which two of (p_x, p_y, p_z, f_x, f_y, f_z) a panel shows
_PLANES = ((0, 1), (1, 2), (3, 5), (4, 5))
_AXES = (
    "toe x [P]",
    "toe y [P]",
    "toe z [P]",
    "force x [weights]",
    "force y [weights]",
    "force z [weights]",
)
_COLORS = {"heuristic": "#697586", "clustering": "#0072B2", "genetic": "#009E73"}
_WIDTHS = {"heuristic": 1.2, "clustering": 2.6, "genetic": 1.2}  # those below show beside
_GOOD, _BAD = "#56B4E9", "#E8A27C"


def draw_boxes(run: EnvelopeRun, name: str) -> Figure:
    """Return every limb's box of each method, with the points of feasible and of infeasible
    terrains.
    """
    limbs = run.limb_names
    figure = new_figure(0.9 + 2.25 * len(limbs), entries=2 + len(run.fitted))
    grid = figure.subplots(len(limbs), len(_PLANES), squeeze=False)
    feasible = run.training.feasible
    for i, limb in enumerate(limbs):
        for ax, (a, b) in zip(grid[i], _PLANES, strict=True):
            style_axes(ax)
            for rows, color in ((~feasible, _BAD), (feasible, _GOOD)):
                point = run.training.point[rows, i]
                ax.scatter(point[:, a], point[:, b], s=4, color=color, linewidths=0, alpha=0.6)
            for fitted in run.fitted:
                for envelope in fitted.envelopes:
                    low, high = envelope.lower[i], envelope.upper[i]
                    ax.add_patch(
                        Rectangle(
                            (low[a], low[b]),
                            high[a] - low[a],
                            high[b] - low[b],
                            fill=False,
                            lw=_WIDTHS[fitted.method],
                            ls="--" if fitted.method == "heuristic" else "-",
                            ec=_COLORS[fitted.method],
                        )
                    )
            ax.autoscale_view()
            ax.set_xlabel(_AXES[a])
            ax.set_ylabel(_AXES[b])
        draw_panel_title(grid[i][0], format_limb_name(limb))
    handles: list[Artist] = [
        Line2D([], [], ls="", marker="o", ms=5, color=color) for color in (_GOOD, _BAD)
    ]
    handles += [
        Line2D(
            [],
            [],
            lw=_WIDTHS[f.method],
            ls="--" if f.method == "heuristic" else "-",
            color=_COLORS[f.method],
        )
        for f in run.fitted
    ]
    labels = ["point of a feasible terrain", "of an infeasible one, without the bilinear rows"]
    draw_foot_legend(figure, handles, [*labels, *(f.method for f in run.fitted)])
    draw_heading(figure, "Envelopes and what they were fitted to", format_plain(name))
    return figure


def draw_fitness(values: Array, name: str) -> Figure:
    """Return fitness (G, 3) of the genetic search: mean, spread, best of each generation (Fig.
    5.11).
    """
    figure = new_figure(3.6, entries=2)
    ax = figure.subplots()
    style_axes(ax)
    generation = np.arange(1, len(values) + 1)
    mean, spread, best = values.T
    ax.fill_between(generation, mean - spread, mean + spread, color=_GOOD, alpha=0.3, lw=0)
    (line,) = ax.plot(generation, mean, color=palette.LIMBS[0], lw=1.8)
    (top,) = ax.plot(generation, best, color=palette.LIMBS[1], lw=1.4, ls="--")
    ax.set_xlabel("generation")
    ax.set_ylabel("fitness")
    draw_foot_legend(figure, [line, top], ["mean, with one standard deviation", "best"])
    draw_heading(figure, "Fitness over the generations", format_plain(name))
    return figure
