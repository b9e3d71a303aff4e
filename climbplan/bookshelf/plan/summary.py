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
        """Compute the statistics of values (K,)."""
        if values.size == 0:
            return cls(np.nan, np.nan, np.nan, np.nan)
        return cls(
            float(np.median(values)),
            float(values.mean()),
            float(np.percentile(values, 99)),
            float(values.max()),
        )


def select_nontrivial_costs(solutions: Solutions) -> Array:
    """Select the costs (K,) [mm^2] of the scenes that need movement."""
    cost = solutions.objective[solutions.placed]
    return cost[cost > TRIVIAL]


def build_summary_lines(plan: ShelfPlan) -> tuple[str, ...]:
    """Build the head, solve and cost lines that a terminal shows."""
    solutions, total = plan.solutions, len(plan.scenes)
    books = f"{plan.scenes.count} stored book{'' if plan.scenes.count == 1 else 's'}"
    count_text = "1 scene" if total == 1 else f"{total} scenes"
    width = f"shelf {1e3 * plan.shelf.width:.1f} mm"
    method = f"method {plan.method}, formulation {plan.meaning}"
    head = f"{plan.name:<16} {count_text}, {books}, {width}, {method}"
    seconds = f"{plan.timings['solve']:.2f} s"
    if total == 1:
        cost = f"cost {solutions.objective[0]:.4g} mm^2"
        if np.isfinite(solutions.bound[0]):
            cost += f", bound {solutions.bound[0]:.4g}"
        effort = _describe_effort(solutions)
        solve = f"{'solve':<9} {solutions.status[0]:<9} {seconds}   {cost}, {effort}"
        return (head, solve)
    time = Spread.of(1e3 * solutions.time)
    placed = solutions.placed
    solved = f"{placed.sum()} of {total}"
    ms = f"median {time.median:.3g} ms, 99 % {time.most99:.3g} ms, worst {time.largest:.3g} ms"
    lines = [head, f"{'solve':<9} {solved:<9} {seconds}   {ms}"]
    if placed.any():
        nontrivial_costs = select_nontrivial_costs(solutions)
        mean = f"mean {solutions.objective[placed].mean():.4g} mm^2"
        nontrivial_text = f"{len(nontrivial_costs)} scenes above {TRIVIAL:g} mm^2"
        mean += (
            f"; {nontrivial_text}: mean {nontrivial_costs.mean():.4g} mm^2"
            if len(nontrivial_costs)
            else f"; {nontrivial_text}"
        )
        lines.append(f"{'cost':<9} {plan.totals.status:<9} {'':>{len(seconds)}}   {mean}")
    missing = [
        f"{solutions.count(status)} {label}"
        for status, label in (
            ("infeasible", "proved infeasible"),
            ("limit", "without an answer"),
        )
        if solutions.count(status)
    ]
    if missing:
        prefix = f"{'others':<9} {total - placed.sum():<9} {'':>{len(seconds)}}"
        lines.append(f"{prefix}   {', '.join(missing)}")
    return tuple(lines)


def _describe_effort(solutions: Solutions) -> str:
    nodes, candidates = solutions.nodes[0], solutions.candidates_tried[0]
    node_text = f"{nodes} node{'' if nodes == 1 else 's'}"
    return f"{node_text}, {candidates} candidate{'' if candidates == 1 else 's'}"
