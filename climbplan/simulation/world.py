"""One world: what robot and terrain really are, beside what the plan believes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True, eq=False)
class World:
    """N limbs of J joints, R surfaces, P footholds of each limb."""

    mass: float  # factor on the robot's mass
    com: Array  # (3,) of the mass, body frame [m]
    stiffness: Array  # (N, J) factor on each joint's
    gain: float  # factor on that of all motors
    friction: Array  # (R,) factor on each surface's
    surface: Array  # (R,) how far each lies before its place, along its normal; a tube: inward [m]
    tilt: Array  # (R, 2) how far each flat one is turned about two axes in its plane [rad]
    backlash: Array  # (N, J) of each joint [rad]
    placement: Array  # (N, P, 3) how far each foothold is missed, world frame [m]

    def __eq__(self, other: object) -> bool:
        """Return the same numbers."""
        return isinstance(other, World) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]  # holds arrays

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-ready values."""
        return {f.name: np.asarray(getattr(self, f.name)).tolist() for f in fields(self)}
