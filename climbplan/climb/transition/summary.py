"""The lines a transition run prints: one a stage, with the figure that matters."""

from __future__ import annotations

from collections import Counter

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.summary import least_safety

_KINDS = 4  # kinds of sequence named


def summary_lines(plan: ClimbPlan) -> tuple[str, ...]:
    """Head, search, motion and force lines as shown on a terminal."""
    seconds, sizes = plan.timings, plan.sizes
    surfaces = ", ".join(s.name for s in plan.terrain.surfaces[:4])
    if len(plan.terrain.surfaces) > 4:
        surfaces += f" and {len(plan.terrain.surfaces) - 4} more"
    count = plan.instants.count
    head = f"{plan.robot.name}, {plan.rounds.count} rounds, {count} instants, surfaces {surfaces}"
    lines = [f"{plan.name:<16} {head}"]
    if plan.sequences is not None and "search" in sizes:
        kinds = Counter(name.partition(":")[0] for name in plan.sequences.name).most_common()
        listed = ", ".join(f"{n} {kind}" for kind, n in kinds[:_KINDS])
        more = f" and {sum(n for _, n in kinds[_KINDS:])} more" if len(kinds) > _KINDS else ""
        found = f"{len(plan.sequences.name)} found"
        lines.append(
            f"{'search':<9} {found:<9} {seconds['search']:.2f} s   {listed}{more}; "
            f"{sizes['search']['force problems']} force problems"
        )
    lines.append(
        f"{'motion':<9} {plan.status:<9} {seconds['motion']:.2f} s   {plan.contact_sequence}, "
        f"cost {plan.objective:.4g}"
    )
    solved = f"{count} of {count}"
    lines.append(f"{'force':<9} {solved:<9} {seconds['force']:.2f} s   {least_safety(plan)}")
    return tuple(lines)
