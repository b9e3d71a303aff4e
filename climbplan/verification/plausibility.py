"""What nothing built has, whatever its kind of plan: told before all else.

A plan may hold all its checks and still be worth nothing, because a number that they start from
was never meant: the effort limits of a URDF that nobody filled in, a stiffness in other units. Such
numbers are no mistakes that can be proved, so they fail nothing; they are warned of, with figures.
"""

from __future__ import annotations

from collections.abc import Iterator

# Toes that brace press with the weight, 1.4 times on the worst of the shipped climbs.
FORCE_RATIO = 4.0
FRICTION = 2.0  # rubber on clean concrete is at 1.2, climbing shoes at 1.5
_EARTH = (1.0, 25.0)  # [m/s^2] Moon to Jupiter


def warn_of_friction(name: str, friction: float) -> Iterator[str]:
    """Yield a friction coefficient that no dry pair of materials has."""
    if friction > FRICTION:
        yield f"friction {friction:g} of {name}: rubber on concrete has about 1"


def warn_of_force(largest: float, weight: float, where: str) -> Iterator[str]:
    """Yield a contact force [N] out of proportion to the robot's weight [N]."""
    if weight > 0 and largest > FORCE_RATIO * weight:
        times = largest / weight
        yield f"a contact force of {largest:.0f} N, {times:.0f} times the robot's weight{where}"


def warn_of_gravity(gravity: float) -> Iterator[str]:
    """Yield a gravity [m/s^2] of no place where robots are."""
    if not _EARTH[0] <= gravity <= _EARTH[1]:
        yield f"gravity {gravity:g} m/s^2: 9.81 on Earth"
