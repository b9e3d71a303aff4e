"""Random worlds of a climb, and one run in each."""

from __future__ import annotations

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.comparison import find_slips
from climbplan.climb.simulation.replay import simulate
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.trials import Drawn, Trial, drawn_worlds


def drawn_conditions(
    plan: ClimbPlan, base: Conditions, count: int, seed: int, most_backlash: float = 0.0
) -> tuple[Conditions, ...]:
    """Worlds for a climb or transition."""
    duration = float(plan.trajectory.time[-1])
    about = Drawn(
        base, plan.robot.limb_count, plan.robot.mass, duration, most_backlash=most_backlash
    )
    return drawn_worlds(about, count, seed)


def climb_trial(plan: ClimbPlan, conditions: Conditions) -> Trial:
    """A climb or transition in one world."""
    run = simulate(plan, conditions)
    return Trial(conditions, run.fallen, float(run.time[-1]), len(find_slips(plan, run)))
