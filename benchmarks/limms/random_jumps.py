"""Jumps drawn at random: platform, goals, sizes of the box, where modules stand.

All like `specs/limms_jump.yaml`: four modules on a platform, a goal in the lower part that no arm
brings the box to.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.errors import SpecError
from climbplan.limms.scene.limms_scene import build_scene
from climbplan.limms.schema.loading import LoadedLimms, limms_of
from climbplan.limms.task_planning.single_actions import find_single_actions
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml

MASS = (1.5, 2.5)  # [kg]
EDGE = 0.6  # [m] of the platform, along x
_HEIGHT = (0.12, 0.24)  # [m] of the platform
_SIZE = (0.26, 0.32)  # [m] of the box along x and y; as high as the mean of both
_START = ((0.0, 0.15), (-0.1, 0.1))  # [m] x and y of the box
_GOAL = ((1.0, 1.12), (-0.1, 0.1))  # [m]
_RISE = (0.12, 0.18)  # [m] of the goal above the box on the ground
_STAND = ((-1.3, -0.9), (-0.9, 0.9))  # [m] x and y of modules
_APART = 0.25  # [m] modules from each other


def random_jump(seed: int) -> LoadedLimms:
    """A scene with four modules and a goal below the platform; the same for the same seed."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            loaded = _jump(rng, seed)
        except SpecError:
            continue  # something overlaps
        kinds = {action.kind for action in find_single_actions(build_scene(loaded)).actions}
        if kinds == {"quadruped"}:
            return loaded


def _jump(rng: np.random.Generator, seed: int) -> LoadedLimms:
    size = rng.uniform(*_SIZE, 2)
    height = round(float(size.mean()), 3)
    level = round(float(rng.uniform(*_HEIGHT)), 3)
    start = [rng.uniform(*span) for span in _START]
    goal = [rng.uniform(*span) for span in _GOAL]
    rise = height / 2 + rng.uniform(*_RISE)
    stands: list[np.ndarray] = []
    while len(stands) < 4:
        place = np.array([rng.uniform(*span) for span in _STAND])
        if all(np.linalg.norm(place - other) > _APART for other in stands):
            stands.append(place)
    modules = "".join(
        f"\n  - {{name: {name}, position: [{x:.4f}, {y:.4f}, {level}]}}"
        for name, (x, y) in zip("ABCD", stands, strict=True)
    )
    text = f"""kind: limms
title: Random jump {seed}
robot: limms_quick
terrain:
  friction: 0.8
  regions:
    - {{name: platform, lower: [-1.6, -1.2, {level}], upper: [{EDGE}, 1.2, 2.2]}}
    - {{name: ground, lower: [{EDGE}, -1.2, 0], upper: [2.6, 1.2, 2.2]}}
  anchors:
    - {{name: left, position: [-0.3, 1.2, 1.0], normal: [0, -1, 0]}}
    - {{name: right, position: [-0.3, -1.2, 1.0], normal: [0, 1, 0]}}
box:
  size: [{size[0]:.4f}, {size[1]:.4f}, {height}]
  mass: {rng.uniform(*MASS):.3f}
  start: [{start[0]:.4f}, {start[1]:.4f}, {level + height / 2:.5f}]
  goal: [{goal[0]:.4f}, {goal[1]:.4f}, {rise:.4f}]
modules:{modules}
seed: {seed}
"""
    name = f"random_jump_{seed}"
    return limms_of(parse_yaml(text, name), SourceText(name, name, Path.cwd(), text))
