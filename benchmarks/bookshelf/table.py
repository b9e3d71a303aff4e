"""The tables of the comparison as text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TextIO

import numpy as np

from benchmarks.bookshelf.context import NOTES, ROWS
from benchmarks.bookshelf.measure import Figures
from benchmarks.bookshelf.published import ALLOWANCES, GRANTED, PublishedReport
from climbplan.bookshelf.plan.summary import TRIVIAL

_REFERENCE = {
    "contact": "the optimum of `exact`",
    "published": "the best known of all methods (`exact` included where it passes this check)",
}


def write_methods(rows: Sequence[Figures], meaning: str, out: TextIO) -> None:
    """Quality and time of all methods in one meaning."""
    if not rows:
        return
    out.write(f"\nmeaning {meaning}; cost against {_REFERENCE[meaning]}\n")
    out.write(
        f"{'':<43}{'scenes':>7}{'success, 95 %':>22}{'cost':>10}"
        f"{'> 1 mm^2':>10}{'in 1 %':>8}{'mean':>8}{'median':>8}{'tried':>7}{'proved':>8}\n"
    )
    for row in rows:
        interval = f"{_percent(row.success)} "
        interval += f"[{100 * row.success_low:.1f}, {100 * row.success_high:.1f}]"
        out.write(
            f"{row.label:<43}{row.scenes:>7}{interval:>22}{_ratio(row.cost_ratio):>10}"
            f"{row.nontrivial:>10}{_percent(row.within_1_percent):>8}{_ratio(row.mean_ratio):>8}"
            f"{_ratio(row.median_ratio):>8}{row.candidates:>7.1f}{row.proved:>8}\n"
        )
    base = next((row for row in rows if row.method == "exact"), rows[0])
    out.write(
        f"{'time of a scene [ms]':<43}{'median':>10}{'mean':>10}{'99 %':>10}{'max':>10}"
        f"{'median / ' + base.method:>20}{'prepare [s]':>13}{'limit [s]':>11}\n"
    )
    for row in rows:
        limit = "" if row.limit_s is None else f"{row.limit_s:g}"
        out.write(
            f"{row.label:<43}{row.median_ms:>10.3g}{row.mean_ms:>10.3g}{row.most99_ms:>10.3g}"
            f"{row.max_ms:>10.3g}{row.median_ms / base.median_ms:>20.3g}"
            f"{row.prepare_s:>13.2g}{limit:>11}\n"
        )
    bounds, above = sum(r.bounds for r in rows), sum(r.bounds_above for r in rows)
    below = sum(r.below_reference for r in rows)
    out.write(f"bounds of solvers above the best known cost: {above} of {bounds} (must be 0)\n")
    out.write(f"answers that cost less than the reference beyond its gap: {below} (must be 0)\n")


def write_published(found: PublishedReport, out: TextIO) -> None:
    """Which constraints the published placements break, and where they are cheaper than ours."""
    out.write(f"\npublished placements through the exact check: {found.scenes} scenes\n")
    out.write(
        f"{'':<32}{'limit':>9}{'broken':>8}{'share':>8}{'by: median':>12}{'90 %':>9}{'max':>9}\n"
    )
    for meaning, passed in found.passed.items():
        out.write(f"meaning {meaning}: {passed} pass\n")
        for row in found.broken:
            if row.meaning == meaning and row.broken:
                out.write(
                    f"  {row.name + ' [' + (row.unit or 'sine') + ']':<30}{row.limit:>9.3g}"
                    f"{row.broken:>8}{row.broken / found.scenes:>8.1%}"
                    f"{row.median:>12.3g}{row.most90:>9.3g}{row.largest:>9.3g}\n"
                )
    out.write(
        "\npublished placements cheaper than our optimum, by the constraint they break most\n"
    )
    out.write(
        f"{'':<43}{'scenes':>8}{'> 1 mm^2':>10}{'cheaper by: median':>20}{'max mm^2':>10}"
        f"{'broken by: median':>19}"
        f"{'max':>9}\n"
    )
    for allowance in ALLOWANCES:
        rows = [row for row in found.rows if row.allowance == allowance]
        cheaper = [row for row in rows if row.cheaper]
        less = np.array([row.ours_mm2 - row.published_mm2 for row in cheaper])
        granted = ", ".join(name.removeprefix("book.") for name in sorted(GRANTED[allowance]))
        head = f"equal {granted}" if granted else "ours without any allowance"
        out.write(
            f"{head:<43}{len(cheaper):>8}{(less > TRIVIAL).sum():>10}{_spread(less, 20, 10)}\n"
        )
        for name in sorted({row.breaks for row in cheaper}):
            part = [row for row in cheaper if row.breaks == name]
            less = np.array([row.ours_mm2 - row.published_mm2 for row in part])
            by = np.array([row.by for row in part])
            label = f"  {name} [{part[0].unit}]" if name else "  nothing that was not granted"
            out.write(
                f"{label:<43}{len(part):>8}{(less > TRIVIAL).sum():>10}{_spread(less, 20, 10)}"
                f"{_spread(by, 19, 9)}\n"
            )
        solved = [row for row in rows if math.isfinite(row.ours_mm2)]
        ours = sum(row.ours_mm2 for row in solved) / max(len(solved), 1)
        theirs = sum(row.published_mm2 for row in solved) / max(len(solved), 1)
        ratio = theirs / ours if ours > 0 else math.nan
        out.write(
            f"  mean cost: published {theirs:.1f}, ours {ours:.1f} mm^2 (ratio {ratio:.2f}); "
            f"ours failed: {len(rows) - len(solved)}\n"
        )
    wrong = sum(row.cheaper and not row.breaks for row in found.rows)
    out.write(f"cheaper without breaking anything that was not granted: {wrong} (must be 0)\n")
    out.write(
        f"brought to their states' angles and the ground, {found.brought.comparable} of them take "
        f"only what can be granted: {found.brought.cheaper} cost less than the bound of `exact` "
        "(must be 0)\n"
    )


def write_context(out: TextIO) -> None:
    """The published tables."""
    out.write("\n" + NOTES)
    out.write(
        f"{'table':<7}{'method':<41}{'success':>9}{'mean ms':>10}{'max ms':>10}"
        f"{'movement mm^2':>15}{'tried':>7}\n"
    )
    for row in ROWS:
        success = "" if row.success is None else f"{row.success:g}%"
        out.write(
            f"{row.table:<7}{row.method:<41}{success:>9}{_plain(row.mean_ms):>10}"
            f"{_plain(row.max_ms):>10}{_plain(row.movement):>15}{_plain(row.tried):>7}\n"
        )


def _spread(values: np.ndarray, first: int, second: int) -> str:
    if not len(values):
        return f"{'':>{first + second}}"
    return f"{np.median(values):>{first}.3g}{values.max():>{second}.3g}"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.4g}%"


def _ratio(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:g}"
