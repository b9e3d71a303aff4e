"""Suggest which quantities should be known better, for a plan that falls in too many worlds.

Quantities that differ between worlds with and without a fall are tried first: each of them with
half its spread, then all together. A suggestion is made only if the plan passes with it.
"""

from __future__ import annotations

from dataclasses import replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.world_sample import MIN_STANDING
from climbplan.climb.simulation.risk.estimation import estimate_risk
from climbplan.climb.simulation.risk.sampling import ENGINE
from climbplan.climb.simulation.worlds.uncertainty import Distribution, Uncertainty
from climbplan.climb.simulation.worlds.uncertainty_spec import KEYS, read_uncertainty
from climbplan.simulation.conditions import Conditions

_NUM_TRIED = 3  # quantities that are tried alone
_QUANTITIES = {key: quantity for key, quantity, _ in KEYS}
_UNITS = {quantity: unit for _, quantity, unit in KEYS}


def suggest_knowledge(plan: ClimbPlan, seed: int, worlds: int) -> str:
    """Find uncertain quantities with which, at half their spread, the plan passes.

    Args:
        plan: A plan that stands in too few worlds.
        seed: Seed of the worlds that are played.
        worlds: How many are played for each quantity that is tried.

    Raises:
        UsageError: The quasi-static engine has no model of the robot.
    """
    stated = read_uncertainty(plan)
    base = estimate_risk(plan, Conditions(), ENGINE, worlds, seed)
    candidates = [_QUANTITIES[key] for key, _ in base.parameters] or list(stated.names)
    tried = [(name,) for name in candidates[:_NUM_TRIED]]
    for names in (*tried, tuple(stated.names)):
        changed = replace(
            stated, **{name: _halve_distribution(getattr(stated, name)) for name in names}
        )
        risk = estimate_risk(plan, Conditions(), ENGINE, worlds, seed, uncertainty=changed)
        if worlds - risk.falls >= MIN_STANDING * worlds:
            overrides_text = ", ".join(_format_distribution(name, changed) for name in names)
            return f"{overrides_text} ({risk.stands} then)"
    return (
        "more than knowing all that is uncertain twice as well: higher friction or stronger motors "
        f"(least S_tau {plan.forces.safety_torque.min():.2f})"
    )


def _halve_distribution(spread: Distribution) -> Distribution:
    return replace(spread, low=spread.low / 2, high=spread.high / 2)


def _format_distribution(name: str, uncertainty: Uncertainty) -> str:
    """Format a quantity and its spread as an override, such as "uncertainty.friction=0.1"."""
    spread, unit = getattr(uncertainty, name), _UNITS[name]
    key = next(key for key, quantity in _QUANTITIES.items() if quantity == name)
    if spread.kind == "normal":
        return f"uncertainty.{key}={spread.high / unit:.3g}"
    low, high = spread.low / unit, spread.high / unit
    return f"uncertainty.{key}={{uniform: [{low:.3g}, {high:.3g}]}}"
