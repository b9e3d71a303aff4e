"""Random climbs as people pose them: half can be planned, the others have to be refused well.

Two upright walls that open towards +y, a robot of 4, 6 or 8 legs, a payload, and now and then a
block between the walls. What a refusal says is tested on these (`refusals`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.climb.posture import braced_robot
from climbplan.schema.robots.robot import RobotSpec
from climbplan.schema.robots.source import load_robot

GAP = (1.05, 1.33)  # [m]
ANGLE = (0.0, 23.0)  # [deg] between the walls
FRICTION = (0.6, 1.4)
PAYLOAD = (0.0, 3.0)  # [kg]
LEGS = (4, 6, 8)


def random_climb(seed: int, folder: Path) -> Path:
    """Write the spec of climb `seed`, and its robot, into a folder; the spec's path."""
    rng = np.random.default_rng([seed, 16])
    legs = int(rng.choice(LEGS))
    rounds = int(rng.integers(3, 9))
    rise = float(rng.uniform(0.05, 0.11)) * rounds
    goal = [0.0, round(float(rng.uniform(-0.1, 0.15)), 3), round(rise, 3)]
    data: dict[str, Any] = {
        "kind": "climb",
        "robot": _robot(legs, folder),
        "terrain": {
            "friction": round(float(rng.uniform(*FRICTION)), 3),
            "walls": {
                "gap": round(float(rng.uniform(*GAP)), 3),
                "angle_deg": round(float(rng.uniform(*ANGLE)), 1),
                "along": [-1.0, 1.2],
                "up": [-1.0, rise + 1.0],
            },
        },
        "task": {"rounds": rounds, "start": {"com": [0, 0, 0]}, "goal": {"com": goal}},
    }
    if rng.random() < 0.5:
        data["task"]["payload"] = {"mass": round(float(rng.uniform(*PAYLOAD)), 2)}
    if rng.random() < 0.5:
        data["terrain"]["obstacles"] = [_block(rng, rise)]
    path = folder / f"climb_{seed}.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def _block(rng: np.random.Generator, rise: float) -> dict[str, Any]:
    """A block beside or across the way."""
    centre = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.6, 0.6), rng.uniform(0.3, 1.2)])
    centre[2] *= max(rise, 0.4)
    half = rng.uniform([0.05, 0.05, 0.05], [0.5, 0.2, 0.15])
    corners = [np.round(centre + sign * half, 3).tolist() for sign in (-1, 1)]
    return {"name": "block", "lower": corners[0], "upper": corners[1]}


def _robot(legs: int, folder: Path) -> str:
    """SiLVIA, SiLVIA without its middle legs, or a longer body with eight of them."""
    if legs == 6:
        return "silvia"
    robot = braced_robot(8) if legs == 8 else _without_middle()
    path = folder / f"robot_{legs}.yaml"
    path.write_text(yaml.safe_dump(robot.model_dump(mode="json", exclude_none=True)))
    return path.name


def _without_middle() -> RobotSpec:
    data = load_robot("silvia").model_dump()
    data.update(
        name="SiLVIA on four legs",
        limbs=[limb for limb in data["limbs"] if limb["name"] not in ("RM", "LM")],
        mass=8.0,
    )
    return RobotSpec.model_validate(data)
