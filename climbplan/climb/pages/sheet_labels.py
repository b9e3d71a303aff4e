"""TEMP"""

from __future__ import annotations

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports.sheet import limb_name


def drawn_labels(plan: ClimbPlan) -> tuple[str, ...]:
    """Where every instant stands in the gait, as it may be drawn."""
    names = tuple(limb_name(name) for name in plan.robot.limb_names)
    return tuple(plan.instants.label(k, names) for k in range(plan.instants.count))
