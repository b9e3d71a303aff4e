"""The figures of a bookshelf run, and the lines it prints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, Solutions

TRIVIAL = 1.0  # [mm^2] scenes that cost no more need next to no movement


@dataclass(frozen=True)
class Spread:
    """Median, mean, 99th percentile and largest of some values; NaN of none."""

    median: float
    mean: float
    most99: float
    largest: float

    @classmethod
    def of(cls, values: Array) -> Spread:
        """Of (K,) values."""
        if values.size == 0:
            return cls(np.nan, np.nan, np.nan, np.nan)
        return cls(
            float(np.median(values)),
            float(values.mean()),
            float(np.percentile(values, 99)),
            float(values.max()),
        )


def nontrivial(solutions: Solutions) -> Array:
    """Costs of the scenes that need movement (K,) [mm^2]."""
    cost = solutions.objective[solutions.placed]
    return cost[cost > TRIVIAL]


def summary_lines(plan: ShelfPlan) -> tuple[str, ...]:
    """Head, solve and cost lines as shown on a terminal."""
    found, total = plan.solutions, len(plan.scenes)
    books = f"{plan.scenes.count} stored book{'' if plan.scenes.count == 1 else 's'}"
    many = "1 scene" if total == 1 else f"{total} scenes"
    width = f"shelf {1e3 * plan.shelf.width:.1f} mm"
    method = f"method {plan.method}, meaning {plan.meaning}"
    head = f"{plan.name:<16} {many}, {books}, {width}, {method}"
    seconds = f"{plan.timings['solve']:.2f} s"
    if total == 1:
        cost = f"cost {found.objective[0]:.4g} mm^2"
        if np.isfinite(found.bound[0]):
            cost += f", bound {found.bound[0]:.4g}"
        solve = f"{'solve':<9} {found.status[0]:<9} {seconds}   {cost}, {_tried(found)}"
        return (head, solve)
    time = Spread.of(1e3 * found.time)
    placed = found.placed
    solved = f"{placed.sum()} of {total}"
    ms = f"median {time.median:.3g} ms, 99 % {time.most99:.3g} ms, worst {time.largest:.3g} ms"
    lines = [head, f"{'solve':<9} {solved:<9} {seconds}   {ms}"]
    if placed.any():
        moving = nontrivial(found)
        mean = f"mean {found.objective[placed].mean():.4g} mm^2"
        share = f"{len(moving)} scenes above {TRIVIAL:g} mm^2"
        mean += f"; {share}: mean {moving.mean():.4g} mm^2" if len(moving) else f"; {share}"
        lines.append(f"{'cost':<9} {plan.totals.status:<9} {'':>{len(seconds)}}   {mean}")
    missing = [
        f"{found.count(status)} {words}"
        for status, words in (
            ("infeasible", "proved infeasible"),
            ("limit", "without an answer"),
        )
        if found.count(status)
    ]
    if missing:
        others = f"{'others':<9} {total - placed.sum():<9} {'':>{len(seconds)}}"
        lines.append(f"{others}   {', '.join(missing)}")
    return tuple(lines)


def _tried(found: Solutions) -> str:
    nodes, tried = found.nodes[0], found.candidates_tried[0]
    return f"{nodes} node{'' if nodes == 1 else 's'}, {tried} candidate{'' if tried == 1 else 's'}"
