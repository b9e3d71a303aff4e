"""The figures of a dataset: how rows ended, what they cost, how long they took."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.store.dataset import Dataset

_MOST_REASONS = 12
_COST_SHARES = (0, 25, 50, 75, 90, 99, 100)


@dataclass(frozen=True)
class Amount:
    """Mean, percentiles and largest of some values; NaN of none."""

    mean: float
    median: float
    most99: float
    largest: float

    @classmethod
    def of(cls, values: Array) -> Amount:
        """Return the figures of (K,) values."""
        if values.size == 0:
            return cls(math.nan, math.nan, math.nan, math.nan)
        return cls(
            float(values.mean()),
            float(np.median(values)),
            float(np.percentile(values, 99)),
            float(values.max()),
        )


def compute_statistics(data: Dataset) -> dict[str, Any]:
    """Return plain values, NaN where nothing is known."""
    drawn_rows = data.drawn
    cost = data.objective[data.feasible]
    strategies = Counter(tuple(row) for row in data.integers[data.feasible].tolist())
    hashes = [text for text, is_drawn in zip(data.hashes(), drawn_rows, strict=True) if is_drawn]
    reasons = Counter(
        text or status
        for text, status, good in zip(data.message, data.status, data.feasible, strict=True)
        if not good
    )
    common_counts = [percentile for _, percentile in strategies.most_common(5)]
    return {
        "rows": {
            "count": data.count,
            "answered": int(data.feasible.sum()),
            "share": float(data.feasible.mean()) if data.count else math.nan,
            "not_drawn": int((~drawn_rows).sum()),
            "same_problem_again": len(hashes) - len(set(hashes)),
            "train": None if data.train is None else int(data.train.sum()),
            "test": None if data.test is None else int(data.test.sum()),
            **data.statuses,
        },
        "cost": {
            **vars(Amount.of(cost)),
            "percentiles": {
                str(percentile): float(np.percentile(cost, percentile)) if cost.size else math.nan
                for percentile in _COST_SHARES
            },
        },
        "time": {**vars(Amount.of(data.time)), "total": float(data.time.sum())},
        "strategies": {
            "distinct": len(strategies),
            "seen_once": sum(count == 1 for count in strategies.values()),
            "share_of_five_commonest": sum(common_counts) / max(1, int(data.feasible.sum())),
        },
        "reasons": dict(reasons.most_common(_MOST_REASONS)),
    }


def format_statistics(data: Dataset) -> list[str]:
    """Return the same for people."""
    figures = compute_statistics(data)
    rows, cost, time = figures["rows"], figures["cost"], figures["time"]
    unit = f" {data.frame.objective_unit}" if data.frame.objective_unit else ""
    ended = ", ".join(f"{count} {status}" for status, count in data.statuses.items())
    sizes = (
        f"{len(data.frame.parameter_names)} parameters, {len(data.frame.integer_names)} integers"
    )
    lines = [
        f"{'problem':<11} {data.frame.problem}, {sizes}",
        f"{'rows':<11} {rows['count']}: {ended}",
    ]
    if rows["answered"]:
        spread = f"mean {cost['mean']:.4g}{unit}, median {cost['median']:.4g}"
        upper_text = f"99 % {cost['most99']:.4g}, largest {cost['largest']:.4g}"
        distinct = f"{figures['strategies']['distinct']} distinct"
        percentage = 100 * figures["strategies"]["share_of_five_commonest"]
        lines += [
            f"{'cost':<11} {spread}, {upper_text}",
            f"{'strategies':<11} {distinct}, the five commonest in {percentage:.0f} % of rows",
        ]
    lines.append(
        f"{'time':<11} mean {1e3 * time['mean']:.3g} ms a row, median {1e3 * time['median']:.3g}, "
        f"99 % {1e3 * time['most99']:.3g}, largest {1e3 * time['largest']:.3g}"
    )
    if rows["same_problem_again"]:
        lines.append(f"{'duplicates':<11} {rows['same_problem_again']}")
    if rows["train"] is not None:
        lines.append(f"{'split':<11} {rows['train']} train, {rows['test']} test")
    lines += [f"{'reason':<11} {count} times: {text}" for text, count in figures["reasons"].items()]
    return lines
