"""A straight climb between two walls with randomly shifted toes: instants of the force problem.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import LimitReached, NoPlanFound
from climbplan.schema.robots.source import load_robot

_GAP, _ROUNDS, _RISE = 1.23, 8, 0.8  # [m], -, [m]
_SHIFT = 0.02  # [m] random shift of each toe in its wall
_TOES = {"F": (0.33, -0.12), "M": (0.0, -0.2), "R": (-0.33, -0.12)}  # y and z by limb row [m]
_DRAWS = 100


@dataclass(frozen=True)
class StraightClimb:
    """The scene and instants of a straight climb between two walls."""

    scene: ClimbScene
    instants: Instants


def build_straight_climb(seed: int) -> StraightClimb:
    """Build eight rounds of SiLVIA straight up between walls with randomly shifted toes.

    The climb has 96 instants. Shifts are sampled until every instant is within the limbs' reach and
    has admissible forces.
    """
    rng = np.random.default_rng(seed)
    for _ in range(_DRAWS):
        try:
            scene = _build_shifted_scene(rng)
            instants = plan_instants(scene, interpolate_rounds(scene))
            plan_forces(scene, instants, "clarabel")
        except NoPlanFound:
            continue
        return StraightClimb(scene, instants)
    raise LimitReached(f"no feasible climb in {_DRAWS} draws of seed {seed}")


def _build_shifted_scene(rng: np.random.Generator) -> ClimbScene:
    """Build a scene with sampled shifts of the toes."""
    toes = {}
    for name in ("RF", "RM", "RR", "LR", "LM", "LF"):
        side = 1.0 if name[0] == "R" else -1.0
        y, z = np.array(_TOES[name[1]]) + rng.uniform(-_SHIFT, _SHIFT, 2)
        toes[name] = (side * _GAP / 2, float(y), float(z))
    raised = {name: (x, y, z + _RISE) for name, (x, y, z) in toes.items()}
    spec = ClimbSpec.model_validate(
        {
            "kind": "climb",
            "margins": "none",  # as published
            "robot": "silvia",
            "terrain": {
                "friction": 1.0,
                "walls": {"gap": _GAP, "along": (-1.0, 1.0), "up": (-1.0, 2.0)},
            },
            "task": {
                "rounds": _ROUNDS,
                "start": {"com": (0.0, 0.0, 0.0), "toes": toes},
                "goal": {"com": (0.0, 0.0, _RISE), "toes": raised},
            },
        }
    )
    return build_scene(spec, load_robot("silvia"))


def interpolate_rounds(scene: ClimbScene) -> Rounds:
    """Interpolate postures evenly between start and goal."""
    phase = np.linspace(0.0, 1.0, scene.spec.task.round_count + 1)

    def interpolate(start: Array, goal: Array) -> Array:
        weight = phase.reshape(-1, *[1] * start.ndim)
        return np.asarray((1 - weight) * start + weight * goal)

    return Rounds(
        com=interpolate(scene.start.com, scene.goal.com),
        rpy=interpolate(scene.start.rpy, scene.goal.rpy),
        toes=interpolate(scene.start.toes, scene.goal.toes),
        region=np.tile(scene.start.region, (len(phase), 1)),
    )
