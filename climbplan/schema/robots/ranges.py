"""Physical ranges of a robot's numbers; values outside have a wrong unit or cannot be computed
with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from climbplan.schema.base import Fault


class Range(NamedTuple):
    """Least and largest size of a quantity."""

    low: float
    high: float
    unit: str

    def holds(self, value: float) -> bool:
        """Return whether a value lies in it."""
        return self.low <= value <= self.high

    @property
    def expected(self) -> str:
        """The range as messages state it: "from 0.0001 to 100 m"."""
        return f"from {self.low:g} to {self.high:g} {self.unit}"


LENGTH = Range(1e-4, 100.0, "m")
THICKNESS = Range(0.0, 100.0, "m")
PLACE = Range(-100.0, 100.0, "m")
MASS = Range(1e-3, 1e6, "kg")
GRAVITY = Range(0.0, 1000.0, "m/s^2")
TORQUE = Range(1e-4, 1e7, "N m")
STIFFNESS = Range(1e-2, 1e8, "N m/rad")
ROTOR_INERTIA = Range(1e-7, 1e5, "kg m^2")
DAMPING = Range(0.0, 1e7, "N m s/rad")
SPEED = Range(1e-3, 1e4, "rad/s")
ANGLE = Range(-1000.0, 1000.0, "rad")

Given = float | Sequence[float] | None


def check_ranges(quantities: Mapping[str, tuple[Given, Range]]) -> list[Fault]:
    """Return faults of values, by dotted keys, outside their ranges; None is left to others."""
    faults = []
    for key, (value, allowed) in quantities.items():
        values = [value] if isinstance(value, float | int) else list(value or ())
        if not all(allowed.holds(number) for number in values):
            text = f"{value:g}" if isinstance(value, float | int) else values
            faults.append(Fault(key, f"expected {allowed.expected}, got {text}"))
    return faults
