"""Legs of a walking robot with joints and motors, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.serial_chain import SerialChain


@dataclass(frozen=True)
class WalkingLegs:
    """L legs of up to J joints: pairs from front to hind, in each the left one first.

    Missing first joints of a leg with fewer move nothing, and their names are empty.
    """

    chain: SerialChain  # body frame of walking; its posture is how the robot stands
    lower: Array  # (L, J) [rad], [m] of joints that slide
    upper: Array  # (L, J) [rad]
    max_torque: Array  # (L, J) [N m], [N]
    max_speed: Array  # (L, J) [rad/s], [m/s]

    @property
    def there(self) -> BoolArray:
        """Whether a leg has an angle of that number, (L, J)."""
        return self.chain.zero.moves

    @property
    def mimics(self) -> BoolArray:
        """Joints that move by the angle of another one, (L, J)."""
        named = np.array([[bool(name) for name in row] for row in self.chain.names])
        return np.asarray(named & ~self.there)
