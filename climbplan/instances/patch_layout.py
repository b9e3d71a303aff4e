"""Random slippery patches before the limbs of a hexapod between two walls."""

from __future__ import annotations

import numpy as np

from climbplan.climb.schema.model import ClimbSpec

LIMIT = 30.0  # [s]
_HALF_GAP, _LOW, _HIGH = 0.615, -0.65, 1.0  # [m]
_COLUMNS = {"F": (0.17, 0.75), "M": (-0.16, 0.16), "R": (-0.75, -0.17)}  # along y [m]
_GOAL_TOE = {"F": 0.23, "M": 0.15, "R": 0.23}  # height at the goal [m]
_KEEP = 0.01  # room about it [m]


def _patch(rng: np.random.Generator, goal: float) -> tuple[float, float]:
    """Middle and half height of a patch that holds no toe at the goal [m]."""
    while True:
        middle, half = float(rng.uniform(0.0, 0.34)), float(rng.uniform(0.02, 0.07))
        if abs(goal - middle) > half + _KEEP:
            return middle, half


def random_layout(rng: np.random.Generator, method: str) -> ClimbSpec:
    """Six slippery patches, one before each limb, of random height and size; four rounds up."""
    regions = []
    for side, sign in (("L", -1.0), ("R", 1.0)):
        for row, (back, front) in _COLUMNS.items():
            middle, half = _patch(rng, _GOAL_TOE[row])
            for name, low, high, friction in (
                ("below", _LOW, middle - half, None),
                ("patch", middle - half, middle + half, 0.001),
                ("above", middle + half, _HIGH, None),
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
