"""Tables of `strategies`, and the files it writes."""

from __future__ import annotations

import math
from typing import TextIO

import numpy as np

from benchmarks.bookshelf.cluster_programs import PROGRAM_HEAD, program_lines
from benchmarks.bookshelf.strategies import (
    CANDIDATES,
    Figures,
    StrategyResult,
)
from benchmarks.bookshelf.strategy_cases import KINDS

_HEAD = (
    f"{'strategy':<10}{'trained':>8}{'tried':>7}{'scenes':>8}{'success':>9}{'+ exact':>9}"
    f"{'hard':>6}{'in 1 %':>8}{'det mm2':>9}{'ratio':>8}{'mean ms':>9}{'99 % ms':>9}{'fit s':>8}"
)


def write_text(result: StrategyResult, stream: TextIO) -> None:
    """Write all tables."""
    print(f"trained on parts of {result.origin}; optima by `exact`", file=stream)
    print(
        "success, in 1 %: without a fallback; + exact: with it; hard: scenes that need more than "
        "1 mm2, in 1 %, det, ratio: of these; reduce tries clusters, on fewer scenes, half of them "
        "hard",
        file=stream,
    )
    largest = max((row.rows for row in result.figures), default=0)
    for setting, kind in KINDS.items():
        rows = [row for row in result.figures if row.setting == setting]
        if not rows:
            continue
        most = max(row.scenes for row in rows)
        hard = max(row.hard for row in rows)
        print(f"\n{setting}: {kind.meaning}; {most} scenes, {hard} need movement", file=stream)
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
    if result.programs:
        _write_programs(result, stream)


def _line(row: Figures) -> str:
    learned = row.contender != "exact"
    trained, tried = (str(row.rows), str(row.candidates)) if learned else ("", "")
    return (
        f"{row.contender:<10}{trained:>8}{tried:>7}{row.scenes:>8}{100 * row.success:>8.1f}%"
        f"{100 * row.fallback:>8.1f}%{row.hard:>6}{100 * row.within:>7.1f}%"
        f"{row.deterioration:>9.2f}{row.ratio:>8.3f}{row.mean_ms:>9.1f}{row.most99_ms:>9.1f}"
        f"{row.fit_seconds:>8.1f}"
    )


def _write_clusters(result: StrategyResult, stream: TextIO) -> None:
    solves = result.clusters
    ended = [solve for solve in solves if solve.status in ("optimal", "feasible")]
    clusters = {solve.cluster for solve in solves}
    solved = {solve.cluster for solve in ended}
    time = np.array([solve.seconds for solve in ended]) if ended else np.zeros(1)
    binaries = [solve.binaries for solve in solves]
    shares = [row.by_program for row in result.figures if math.isfinite(row.by_program)]
    scenes = [row.scenes for row in result.figures if math.isfinite(row.by_program)]
    print(
        f"\nreduced programs of these scenes: {len(ended)} of {len(solves)} solved, in "
        f"{len(solved)} of {len(clusters)} clusters; {min(binaries)} to {max(binaries)} binaries; "
        f"median {np.median(time):.2f} s, worst {time.max():.2f} s; "
        f"{100 * np.average(shares, weights=scenes):.0f} % of placements at a program's integers, "
        "the rest at others of its cluster",
        file=stream,
    )


def _write_programs(result: StrategyResult, stream: TextIO) -> None:
    print(
        "\nprograms of clusters drawn at random, each at the unseen scene likeliest to be in it; "
        "whole: not reduced, at scenes that need movement; exact: made exact, it holds",
        file=stream,
    )
    print(PROGRAM_HEAD, file=stream)
    for line in program_lines(result.programs):
        print(line, file=stream)
