"""A climb to try things on: SiLVIA straight up between two walls, postures by interpolation."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.instances.straight_climb import interpolate_rounds
from climbplan.schema.robots.robot import RobotSpec
from climbplan.schema.robots.source import load_robot

_RISE = 0.3
_TOES = {
    "RF": (0.615, 0.33, -0.12),
    "RM": (0.615, 0.0, -0.18),
    "RR": (0.615, -0.33, -0.12),
    "LR": (-0.615, -0.33, -0.12),
    "LM": (-0.615, 0.0, -0.18),
    "LF": (-0.615, 0.33, -0.12),
}
_DEMO: dict[str, Any] = {
    "kind": "climb",
    "margins": "none",  # the force problem as published; margins have tests of their own
    "robot": "silvia",
    "terrain": {
        "friction": 1.0,
        "walls": {"gap": 1.23, "along": (-0.8, 0.8), "up": (-1.0, 2.0)},
    },
    "task": {
        "rounds": 3,
        "start": {"com": (0.0, 0.0, 0.0), "toes": _TOES},
        "goal": {
            "com": (0.0, 0.0, _RISE),
            "toes": {name: (x, y, z + _RISE) for name, (x, y, z) in _TOES.items()},
        },
    },
}

SceneMaker = Callable[..., ClimbScene]


def demo_climb(robot: RobotSpec | None = None, **values: Any) -> ClimbScene:
    """The demo scene with other values: `demo_climb(**{"terrain.friction": 0.4})`.

    Another robot stands at its own nominal stances.
    """
    spec = copy.deepcopy(_DEMO)
    if robot is not None:
        for end in ("start", "goal"):
            del spec["task"][end]["toes"]
    for key, value in values.items():
        *path, last = key.split(".")
        node = spec
        for name in path:
            node = node.setdefault(name, {})
        node[last] = value
    return build_scene(ClimbSpec.model_validate(spec), robot or load_robot("silvia"))


@pytest.fixture(scope="session")
def demo_scene() -> ClimbScene:
    return demo_climb()


@pytest.fixture(scope="session")
def demo_rounds(demo_scene: ClimbScene) -> Rounds:
    return interpolate_rounds(demo_scene)


@pytest.fixture(scope="session")
def demo_instants(demo_scene: ClimbScene, demo_rounds: Rounds) -> Instants:
    return plan_instants(demo_scene, demo_rounds)


@pytest.fixture(scope="session", name="demo_climb")
def _demo_climb() -> SceneMaker:
    return demo_climb
