"""The picture of `strategies`: quality and time by data and candidates, on other scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.bookshelf.strategies import CANDIDATES, Figures, StrategyResult
from benchmarks.bookshelf.strategy_cases import KINDS, SAME

_INK, _MUTED, _GRID = "#1F2933", "#697586", "#E4E7EB"
_COLORS = {
    "random": "#9AA5B1",
    "knn": "#0072B2",
    "forest": "#009E73",
    "boosting": "#E69F00",
    "network": "#D55E00",
    "reduce": "#882255",
}
_MARKERS = {
    "random": "x",
    "knn": "o",
    "forest": "s",
    "boosting": "^",
    "network": "D",
    "reduce": "P",
}
_LEAST = 1e-2  # [mm^2] deterioration that is drawn of a smaller one


def comparison(result: StrategyResult) -> Figure:
    """Success, share near the optimum, deterioration and time by data; the second by candidates
    and on scenes unlike those trained on."""
    figure = Figure(figsize=(13.0, 7.4), dpi=150, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    most, largest = max(CANDIDATES), max((row.rows for row in result.figures), default=0)
    same = [row for row in result.figures if row.setting == SAME]
    # Of `reduce` candidates are clusters: one of them stands for all.
    by_data = [row for row in same if row.candidates == most or row.contender == "reduce"]
    data = "solved scenes trained on"
    note = f"{most} candidates, reduce: clusters"
    _curves(axes[0, 0], by_data, lambda row: row.rows, lambda row: 100 * row.success)
    _dress(axes[0, 0], "Placements that hold, no fallback [%]", data, note)
    _curves(axes[0, 1], by_data, lambda row: row.rows, lambda row: 100 * row.within)
    _dress(axes[0, 1], "Within 1 % of the optimum [%]", data, "scenes that need movement")
    _curves(axes[0, 2], by_data, lambda row: row.rows, lambda row: max(row.deterioration, _LEAST))
    axes[0, 2].set_yscale("log")
    _dress(axes[0, 2], "Mean cost above the optimum [mm\u00b2]", data, "scenes that need movement")
    _curves(axes[1, 0], by_data, lambda row: row.rows, lambda row: row.mean_ms)
    axes[1, 0].set_yscale("log")
    exact = next((row.mean_ms for row in same if row.contender == "exact"), math.nan)
    axes[1, 0].axhline(exact, color=_INK, lw=1.2, ls=":")
    _dress(axes[1, 0], "Mean time of a scene [ms]", data, note)
    ranked = [row for row in same if row.rows == largest and row.contender != "reduce"]
    _curves(axes[1, 1], ranked, lambda row: row.candidates, lambda row: 100 * row.within)
    _dress(
        axes[1, 1],
        "Within 1 % of the optimum [%]",
        "candidates tried",
        f"{largest} solved scenes",
    )
    for ax in (axes[0, 0], axes[0, 1], axes[1, 1]):
        _percent(ax)
    _others(axes[1, 2], result, largest, most)
    names = [name for name in _COLORS if any(row.contender == name for row in result.figures)]
    handles = [
        Line2D([], [], color=_COLORS[name], marker=_MARKERS[name], ms=6, lw=1.8) for name in names
    ]
    handles.append(Line2D([], [], color=_INK, lw=1.2, ls=":"))
    figure.legend(
        handles,
        [*names, "exact"],
        loc="outside lower center",
        ncols=len(handles),
        frameon=False,
        fontsize=10,
    )
    return figure


def _curves(
    ax: Axes,
    rows: Sequence[Figures],
    at: Callable[[Figures], int],
    value: Callable[[Figures], float],
) -> None:
    for name, color in _COLORS.items():
        mine = sorted((row for row in rows if row.contender == name), key=at)
        if mine:
            ax.plot(
                [at(row) for row in mine],
                [value(row) for row in mine],
                marker=_MARKERS[name],
                color=color,
                lw=1.8,
                ms=6,
            )
    ticks = sorted({at(row) for row in rows})
    ax.set_xscale("log")
    ax.set_xticks(ticks, [str(tick) for tick in ticks])
    ax.minorticks_off()


def _percent(ax: Axes) -> None:
    values = [float(y) for line in ax.lines for y in np.asarray(line.get_ydata(), float)]
    low = min((y for y in values if math.isfinite(y)), default=0.0)
    ax.set_ylim(min(max(5 * math.floor((low - 2) / 5), 0), 95), 101 if low > 50 else 103)


def _dress(ax: Axes, title: str, label: str, note: str) -> None:
    ax.set_title(title, fontsize=11, loc="left", color=_INK, fontweight="bold", pad=20)
    ax.text(0, 1.02, note, transform=ax.transAxes, fontsize=9, color=_MUTED, va="bottom")
    ax.set_xlabel(label, fontsize=9, color=_MUTED)
    ax.tick_params(labelsize=9, colors=_MUTED)
    ax.grid(color=_GRID, lw=0.8)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(_GRID)


def _others(ax: Axes, result: StrategyResult, largest: int, most: int) -> None:
    """Dots side by side: within 1 % on each kind of scenes."""
    names = [name for name in _COLORS if any(row.contender == name for row in result.figures)]
    labels = []
    for s, setting in enumerate(KINDS):
        hard = 0
        for k, name in enumerate(names):
            rows = [
                row
                for row in result.figures
                if row.setting == setting
                and row.contender == name
                and row.rows == largest
                and (row.candidates == most or name == "reduce")
            ]
            if rows and math.isfinite(rows[0].within):
                x, y = s + 0.13 * (k - (len(names) - 1) / 2), 100 * rows[0].within
                ax.plot([x, x], [0, y], color=_COLORS[name], lw=1.2, alpha=0.5)
                ax.plot(x, y, marker=_MARKERS[name], color=_COLORS[name], ms=7, ls="")
                hard = max(hard, rows[0].hard)
        labels.append(f"{setting}\n{hard} scenes")
    ax.set_ylim(0, 103)
    _dress(ax, "Within 1 % on scenes unlike the data [%]", "", f"{largest} solved scenes")
    ax.set_xticks(range(len(labels)), labels)
    ax.grid(visible=False, axis="x")
