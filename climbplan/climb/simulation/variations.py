"""Draw random worlds of a climb and simulate it in one of them."""

from __future__ import annotations

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.comparison import find_slips
from climbplan.climb.simulation.replay import simulate
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.trials import ConditionsDistribution, RandomRun, sample_conditions


def draw_conditions(
    plan: ClimbPlan, base: Conditions, count: int, seed: int, most_backlash: float = 0.0
) -> tuple[Conditions, ...]:
    """Draw the conditions of random worlds for a climb or transition."""
    duration = float(plan.trajectory.time[-1])
    scenario_settings = ConditionsDistribution(
        base, plan.robot.limb_count, plan.robot.mass, duration, max_backlash=most_backlash
    )
    return sample_conditions(scenario_settings, count, seed)


def run_climb_trial(plan: ClimbPlan, conditions: Conditions) -> RandomRun:
    """Simulate a climb or transition in one world."""
    run = simulate(plan, conditions)
    return RandomRun(conditions, run.fallen, float(run.time[-1]), len(find_slips(plan, run)))
