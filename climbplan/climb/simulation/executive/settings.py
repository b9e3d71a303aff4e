"""Thresholds of closed-loop execution, and what it notices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from climbplan.errors import UsageError

EventKind = Literal["touched", "waited", "forces", "slipped", "returned", "retreated", "stopped"]


@dataclass(frozen=True)
class ExecutiveSettings:
    """Thresholds of measurements and waiting times. Weights are those of the robot."""

    touch_force: float = 0.05  # of a toe that has met its surface, by weight
    search_speed: float = 0.02  # [m/s] of a toe that searches its surface
    search_range: float = 0.03  # [m] before and behind the planned place
    retraction_speed: float = 0.01  # [m/s] of a toe that still carries when it is to lift
    filter_time: float = 0.05  # [s] time constant of forces
    unloaded_force: float = 0.05  # of a limb that may lift, by weight
    friction_use: float = 0.85  # of the friction coefficient, of toes that stay at a lift
    min_pressure: float = 0.03  # of toes that stay at a lift, by weight
    patience: float = 10.0  # [s] that a lift waits before the robot stops
    min_margin_fraction: float = 0.2  # of margins, once a surface showed less friction
    max_returns: int = 3  # of a limb to where it stood, before the robot stops
    return_speed: float = 2.0  # of the clock, by the plan's
    pause: float = 2.0  # [s] after a limb has returned
    slip: float = 4e-3  # [m] of a toe against the others, from which it has slipped
    max_slide: float = 0.05  # [m] of a toe along its surface, off its planned foothold
    slip_time: float = 1.0  # [s] in which slips show the friction of a surface once
    blend_time: float = 0.7  # [s] in which forces change in a stance
    reaction_time: float = 0.2  # [s] likewise, once a toe has slipped
    load_limit: float = 0.5  # of a load that the plan does not know, by weight
    load_weight: float = 0.5  # of a new measurement of the load

    def __post_init__(self) -> None:
        """Raise UsageError for a value that is not positive."""
        for name, value in vars(self).items():
            if not value > 0:
                raise UsageError(f"{name} {value}: expected a positive number")


class ExecutiveEvent(NamedTuple):
    """Something that the executive noticed or did."""

    time: float  # [s] since the start
    clock: float  # [s] of the plan
    kind: EventKind
    limb: int  # -1 of none
    # touched: beyond the planned place [m]; slipped: how far [m]; waited: how long [s]; forces:
    # fraction of the margins that they keep
    value: float


def describe_event(event: ExecutiveEvent, names: Sequence[str]) -> str:
    """Describe an event in words; names: of the limbs."""
    limb = names[event.limb] if event.limb >= 0 else "the robot"
    return {
        "touched": f"{limb} meets its surface {1e3 * event.value:.0f} mm behind its place",
        "waited": f"waits for {event.value:.1f} s",
        "forces": f"forces are solved again, with {event.value:.0%} of their margins",
        "slipped": f"{limb} slips by {1e3 * event.value:.0f} mm",
        "returned": f"{limb} returns to where it stood, as a toe slips",
        "retreated": f"{limb} finds no surface and returns to where it stood",
        "stopped": "the robot stops",
    }[event.kind]
