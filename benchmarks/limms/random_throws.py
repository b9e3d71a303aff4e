"""Throws drawn at random: goals, sizes and places of the box, where the module stands.

All like `specs/limms_throw.yaml`: one module, one anchor on the wall, a goal that no side of the
box can be held at from there; at its start one can.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.bounds import Connection, is_within_reach
from climbplan.limms.scene.limms_scene import build_scene
from climbplan.limms.schema.loading import LoadedLimms, limms_of
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml

MASS = 0.3  # [kg]
_SIZE = (0.14, 0.24)  # [m] along x and y; as high as the mean of both
_START = ((0.55, 0.8), (-0.15, 0.15))  # [m] x and y of the box
_GOAL = ((0.65, 0.85), (-0.1, 0.1), (1.38, 1.52))  # [m]
_STAND = ((0.35, 1.3), (0.55, 0.9))  # [m] x, and y either way


def random_throw(seed: int) -> LoadedLimms:
    """A scene with one module and a goal above its reach; the same for the same seed."""
    rng = np.random.default_rng(seed)
    while True:
        loaded = _throw(rng, seed)
        scene = build_scene(loaded)
        sides = [[Connection(0, side)] for side in range(4)]
        if any(is_within_reach(scene, side, scene.goal) for side in sides):
            continue
        if any(is_within_reach(scene, side, scene.box_start[0]) for side in sides):
            return loaded


def _throw(rng: np.random.Generator, seed: int) -> LoadedLimms:
    size = rng.uniform(*_SIZE, 2)
    height = round(float(size.mean()), 3)
    start = [rng.uniform(*span) for span in _START]
    goal = [rng.uniform(*span) for span in _GOAL]
    stand = [rng.uniform(*_STAND[0]), rng.choice([-1.0, 1.0]) * rng.uniform(*_STAND[1])]
    text = f"""kind: limms
title: Random throw {seed}
robot: limms_quick
terrain:
  friction: 0.8
  regions:
    - {{name: room, lower: [0, -1.2, 0], upper: [2.6, 1.2, 2.6]}}
  anchors:
    - {{name: wall, position: [0, 0, 0.7], normal: [1, 0, 0]}}
box:
  size: {_row([*size, height])}
  mass: {MASS}
  start: {_row([*start, height / 2], 5)}
  goal: {_row(goal)}
  arrival_speed: 1.5
modules:
  - {{name: A, position: {_row([*stand, 0.0])}}}
seed: {seed}
"""
    name = f"random_throw_{seed}"
    return limms_of(parse_yaml(text, name), SourceText(name, name, Path.cwd(), text))


def _row(values: list[float] | Array, digits: int = 4) -> str:
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"
