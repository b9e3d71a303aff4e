"""What a plan that falls in too many of its worlds would need: quantities that are known better.

Quantities that tell falls from stands are tried first: each of them with half its spread, then all
together. What is said to help was played.
"""

from __future__ import annotations

from dataclasses import replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.world_sample import MIN_STANDING
from climbplan.climb.simulation.risk.judging import judge_plan
from climbplan.climb.simulation.risk.sampling import ENGINE
from climbplan.climb.simulation.worlds.stated import KEYS, uncertainty_of
from climbplan.climb.simulation.worlds.uncertainty import Spread, Uncertainty
from climbplan.simulation.conditions import Conditions

_NUM_TRIED = 3  # quantities that are tried alone
_QUANTITIES = {key: quantity for key, quantity, _ in KEYS}
_UNITS = {quantity: unit for _, quantity, unit in KEYS}


def needed_to_stand(plan: ClimbPlan, seed: int, worlds: int) -> str:
    """What of its uncertainty, halved, would have the plan stand in enough worlds.

    Args:
        plan: A plan that stands in too few worlds.
        seed: Seed of the worlds that are played.
        worlds: How many are played for each quantity that is tried.

    Raises:
        UsageError: The quasi-static engine has no model of the robot.
    """
    stated = uncertainty_of(plan)
    base = judge_plan(plan, Conditions(), ENGINE, worlds, seed)
    likely = [_QUANTITIES[key] for key, _ in base.parameters] or list(stated.names)
    tried = [(name,) for name in likely[:_NUM_TRIED]]
    for names in (*tried, tuple(stated.names)):
        changed = replace(stated, **{name: _halved(getattr(stated, name)) for name in names})
        judged = judge_plan(plan, Conditions(), ENGINE, worlds, seed, uncertainty=changed)
        if worlds - judged.falls >= MIN_STANDING * worlds:
            shown = ", ".join(_shown(name, changed) for name in names)
            return f"{shown} ({judged.stands} then)"
    return (
        "more than knowing all that is uncertain twice as well: rougher walls or stronger motors "
        f"(least S_tau {plan.forces.safety_torque.min():.2f})"
    )


def _halved(spread: Spread) -> Spread:
    return replace(spread, low=spread.low / 2, high=spread.high / 2)


def _shown(name: str, uncertainty: Uncertainty) -> str:
    """A quantity and its spread as a spec states it: "uncertainty.friction=0.1"."""
    spread, unit = getattr(uncertainty, name), _UNITS[name]
    key = next(key for key, quantity in _QUANTITIES.items() if quantity == name)
    if spread.kind == "normal":
        return f"uncertainty.{key}={spread.high / unit:.3g}"
    low, high = spread.low / unit, spread.high / unit
    return f"uncertainty.{key}={{uniform: [{low:.3g}, {high:.3g}]}}"
