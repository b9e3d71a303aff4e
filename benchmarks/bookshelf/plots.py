"""Success, cost ratio and time of all methods as pictures; both meanings side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.bookshelf.measure import Figures, Run
from climbplan.arrays import Array
from climbplan.bookshelf.plan.summary import TRIVIAL

_INK, _MUTED, _BAR, _DOT = "#1F2933", "#697586", "#0072B2", "#D55E00"
_DPI = 150
_LEAST_EXCESS = 1e-4  # what is drawn of a smaller one


def write_plots(
    runs: Sequence[Run],
    figures: Sequence[Figures],
    best: dict[str, Array],
    directory: Path,
) -> list[Path]:
    """Write success.png, cost.png and time.png; runs and their figures in the same order."""
    meanings = [m for m in ("contact", "published") if any(run.meaning == m for run in runs)]
    drawn = (("success", _success), ("cost", _cost), ("time", _time))
    paths = []
    for name, draw in drawn:
        most = max(sum(run.meaning == m for run in runs) for m in meanings)
        size = (5.2 * len(meanings) + 2.6, 0.36 * most + 1.5)
        figure = Figure(figsize=size, dpi=_DPI, facecolor="white", layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(meanings), squeeze=False, sharex=name == "time")[0]
        for ax, meaning in zip(axes, meanings, strict=True):
            pairs = [
                (run, row) for run, row in zip(runs, figures, strict=True) if run.meaning == meaning
            ]
            draw(ax, [run for run, _ in pairs], [row for _, row in pairs], best[meaning])
            _dress(ax, [row for _, row in pairs], meaning)
        paths.append(directory / f"{name}.png")
        figure.savefig(paths[-1])
    return paths


def _dress(ax: Axes, rows: Sequence[Figures], meaning: str) -> None:
    labels = [f"{row.label} ({row.scenes})" for row in rows]
    ax.set_yticks(range(len(rows)), labels, fontsize=8, color=_INK)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_title(f"meaning {meaning}", loc="left", fontsize=10, color=_INK, fontweight="bold")
    ax.tick_params(axis="x", labelsize=8, colors=_MUTED)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="x", color="#E4E7EB", linewidth=0.8)
    ax.set_axisbelow(True)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)


def _success(ax: Axes, runs: Sequence[Run], rows: Sequence[Figures], best: Array) -> None:
    share = 100 * np.array([row.success for row in rows])
    low = 100 * np.array([row.success_low for row in rows])
    high = 100 * np.array([row.success_high for row in rows])
    at = np.arange(len(rows))
    ax.barh(at, share, height=0.62, color=_BAR, alpha=0.55)
    ax.errorbar(
        share, at, xerr=np.stack([share - low, high - share]), fmt="none", ecolor=_INK,
        elinewidth=1.2, capsize=3,
    )  # fmt: skip
    for k, value in enumerate(share):
        ax.text(103, k, f"{value:.4g}", va="center", ha="left", fontsize=7.5, color=_MUTED)
    ax.set_xlim(0, 113)
    ax.set_xlabel("answers that pass the exact check [%], 95 % interval", fontsize=8.5, color=_INK)


def _cost(ax: Axes, runs: Sequence[Run], rows: Sequence[Figures], best: Array) -> None:
    rng = np.random.default_rng(0)
    for k, run in enumerate(runs):
        cost, known = run.cost, best[run.scene]
        use = np.isfinite(cost) & np.isfinite(known) & (known > TRIVIAL)
        excess = np.maximum(cost[use] / known[use] - 1, _LEAST_EXCESS)
        if len(excess):
            _spread(ax, k, excess, rng)
        else:
            ax.text(2 * _LEAST_EXCESS, k, "none solved", va="center", fontsize=7.5, color=_MUTED)
    ax.axvline(0.01, color=_MUTED, linewidth=1, linestyle=":")
    ax.set_xscale("log")
    ax.set_xlim(0.7 * _LEAST_EXCESS, None)
    ax.set_xlabel(
        "cost / reference - 1, scenes above 1 mm² (left end: equal)",
        fontsize=8.5, color=_INK,
    )  # fmt: skip


def _time(ax: Axes, runs: Sequence[Run], rows: Sequence[Figures], best: Array) -> None:
    rng = np.random.default_rng(0)
    for k, run in enumerate(runs):
        _spread(ax, k, 1e3 * np.array([answer.seconds for answer in run.answers]), rng)
    ax.set_xscale("log")
    ax.set_xlabel("time of a scene [ms]", fontsize=8.5, color=_INK)


def _spread(ax: Axes, at: int, values: Array, rng: np.random.Generator) -> None:
    """All values as dots, quartiles as a box, the median as a stroke."""
    jitter = rng.uniform(-0.2, 0.2, len(values))
    ax.scatter(values, at + jitter, s=5, color=_BAR, alpha=0.35, linewidths=0)
    first, middle, last = np.quantile(values, [0.25, 0.5, 0.75])
    ax.plot([first, last], [at, at], color=_INK, linewidth=2.2, solid_capstyle="butt")
    ax.plot([middle, middle], [at - 0.28, at + 0.28], color=_DOT, linewidth=2)
