"""Tables and plots of `bench strategies`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from climbplan.bookshelf.benchmarks.strategies import (
    CANDIDATES,
    MEANT,
    Figures,
    StrategyOptions,
    StrategyResult,
    as_json,
)

_COLORS = {
    "random": "#697586",
    "knn": "#0072B2",
    "forest": "#009E73",
    "boosting": "#E69F00",
    "network": "#D55E00",
    "reduce": "#882255",
}
_HEAD = (
    f"{'strategy':<10}{'scenes':>8}{'tried':>7}{'success':>9}{'+ exact':>9}{'in 1 %':>9}"
    f"{'det mm2':>9}{'ratio':>8}{'mean ms':>9}{'99 % ms':>9}{'fit s':>8}"
)


def write_text(result: StrategyResult, stream: TextIO) -> None:
    """The tables, as `bench` prints them."""
    print(f"trained on parts of {result.origin}; optima by `exact`", file=stream)
    print(
        "success, in 1 %: without a fallback; + exact: with it; in 1 %, det, ratio: scenes that "
        "need more than 1 mm2",
        file=stream,
    )
    largest = max((row.rows for row in result.figures), default=0)
    for setting, meaning in MEANT.items():
        rows = [row for row in result.figures if row.setting == setting]
        if not rows:
            continue
        most = max(row.scenes for row in rows)
        hard = max(row.hard for row in rows)
        print(f"\n{setting}: {meaning}; {most} scenes, {hard} need movement", file=stream)
        print(_HEAD, file=stream)
        for row in rows:
            full = row.rows in (0, largest)
            if (
                row.candidates in (0, 1, 10, max(CANDIDATES))
                if full
                else (row.candidates == max(CANDIDATES))
            ):
                print(_line(row), file=stream)
    if result.clusters:
        _write_clusters(result, stream)


def write_files(result: StrategyResult, options: StrategyOptions, directory: Path) -> None:
    """bench.txt, bench.json and figures/*.png."""
    with (directory / "bench.txt").open("w", encoding="utf-8") as stream:
        write_text(result, stream)
    text = json.dumps(as_json(result, options), indent=2, allow_nan=False)
    (directory / "bench.json").write_text(text + "\n", encoding="utf-8")
    (directory / "figures").mkdir(exist_ok=True)
    figure = comparison(result)
    figure.savefig(directory / "figures" / "strategies.png")


def _line(row: Figures) -> str:
    tried = "" if row.contender == "exact" else str(row.candidates)
    scenes = "" if row.contender == "exact" else str(row.rows)
    return (
        f"{row.contender:<10}{scenes:>8}{tried:>7}{100 * row.success:>8.1f}%"
        f"{100 * row.fallback:>8.1f}%{100 * row.within:>8.1f}%{row.deterioration:>9.2f}"
        f"{row.ratio:>8.3f}{row.mean_ms:>9.1f}{row.most99_ms:>9.1f}{row.fit_seconds:>8.1f}"
    )


def _write_clusters(result: StrategyResult, stream: TextIO) -> None:
    solves = result.clusters
    ended = [solve for solve in solves if solve.status in ("optimal", "feasible")]
    clusters = {solve.cluster for solve in solves}
    solved = {solve.cluster for solve in ended}
    time = np.array([solve.seconds for solve in ended]) if ended else np.zeros(1)
    binaries = [solve.binaries for solve in solves]
    print(
        f"\nreduced programs: {len(ended)} of {len(solves)} solved, in {len(solved)} of "
        f"{len(clusters)} clusters; {min(binaries)} to {max(binaries)} binaries; "
        f"median {np.median(time):.2f} s, worst {time.max():.2f} s",
        file=stream,
    )


def comparison(result: StrategyResult) -> Figure:
    """Quality by data, by candidates, and on other scenes."""
    figure = Figure(figsize=(13.0, 4.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    by_data, by_candidates, other = figure.subplots(1, 3)
    largest = max((row.rows for row in result.figures), default=0)
    most = max(CANDIDATES)
    same = [row for row in result.figures if row.setting == "same"]
    _curves(
        by_data,
        [row for row in same if row.candidates == most],
        lambda row: row.rows,
        "solved scenes trained on",
        f"{most} candidates",
    )
    _curves(
        by_candidates,
        [row for row in same if row.rows == largest and row.contender != "reduce"],
        lambda row: row.candidates,
        "candidates",
        f"{largest} solved scenes",
    )
    _bars(other, result, largest, most)
    return figure


def _curves(
    ax: Axes, rows: list[Figures], at: Callable[[Figures], int], label: str, title: str
) -> None:
    for name, color in _COLORS.items():
        mine = sorted((row for row in rows if row.contender == name), key=at)
        if mine:
            x = [at(row) for row in mine]
            ax.plot(x, [100 * row.within for row in mine], "o-", color=color, label=name, ms=4)
            ax.plot(x, [100 * row.success for row in mine], "--", color=color, lw=0.9)
    ax.set_xscale("log")
    ax.set_ylim(0, 102)
    ax.set_xlabel(label)
    ax.set_ylabel("scenes [%] (solid: within 1 %, dashed: success)")
    ax.set_title(title, fontsize=10, loc="left")
    ax.grid(lw=0.4)
    if rows:
        ax.legend(fontsize=8, frameon=False)


def _bars(ax: Axes, result: StrategyResult, largest: int, most: int) -> None:
    settings = list(MEANT)
    for k, (name, color) in enumerate(_COLORS.items()):
        for s, setting in enumerate(settings):
            rows = [
                row
                for row in result.figures
                if row.setting == setting
                and row.contender == name
                and row.rows == largest
                and (row.candidates == most or name == "reduce")
            ]
            if rows and np.isfinite(rows[0].within):
                ax.bar(s + 0.13 * (k - 2.5), 100 * rows[0].within, 0.12, color=color)
    ax.set_xticks(range(len(settings)), settings)
    ax.set_ylim(0, 102)
    ax.set_ylabel("within 1 % of the optimum [%]")
    ax.set_title("Scenes unlike those trained on", fontsize=10, loc="left")
    ax.grid(axis="y", lw=0.4)
