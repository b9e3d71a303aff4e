"""Random slippery patches in front of the limbs of a hexapod between two walls.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.climb.schema.model import ClimbSpec

LIMIT = 30.0  # [s]
_HALF_GAP, _LOW, _HIGH = 0.615, -0.65, 1.0  # [m]
_COLUMNS = {"F": (0.17, 0.75), "M": (-0.16, 0.16), "R": (-0.75, -0.17)}  # along y [m]
_GOAL_TOE = {"F": 0.23, "M": 0.15, "R": 0.23}  # height at the goal [m]
_KEEP = 0.01  # distance of a patch from the toe at the goal [m]


def _sample_patch(rng: np.random.Generator, goal: float) -> tuple[float, float]:
    """Return center and half height of a patch that contains no toe at the goal [m]."""
    while True:
        center, half = float(rng.uniform(0.0, 0.34)), float(rng.uniform(0.02, 0.07))
        if abs(goal - center) > half + _KEEP:
            return center, half


def generate_layout(rng: np.random.Generator, method: str) -> ClimbSpec:
    """Generate six slippery patches of random height and size, one for each limb."""
    regions = []
    for side, sign in (("L", -1.0), ("R", 1.0)):
        for row, (back, front) in _COLUMNS.items():
            center, half = _sample_patch(rng, _GOAL_TOE[row])
            for name, low, high, friction in (
                ("below", _LOW, center - half, None),
                ("patch", center - half, center + half, 0.001),
                ("above", center + half, _HIGH, None),
            ):
                regions.append(
                    {
                        "name": f"{side}{row} {name}",
                        "rectangle": {
                            "center": (sign * _HALF_GAP, (back + front) / 2, (low + high) / 2),
                            "normal": (-sign, 0.0, 0.0),
                            "width": front - back,
                            "height": high - low,
                        },
                        "limbs": [f"{side}{row}"],
                        "friction": friction,
                    }
                )
    return ClimbSpec.model_validate(
        {
            "kind": "climb",
            "margins": "none",  # as published
            "robot": "silvia",
            "terrain": {"friction": 1.0, "regions": regions},
            "task": {
                "rounds": 4,
                "start": {"com": (0.0, 0.0, 0.0)},
                "goal": {"com": (0.0, 0.0, 0.35)},
            },
            "solver": {"method": method, "time_limit": LIMIT},
        }
    )
