"""Rooms drawn at random: 1 to 4 modules, 0 to 3 obstacles, a box to bring near, far or high.

In rooms of turned goals the box is to be turned as well, by any angle about the vertical.

A room has rows of anchors on its two long walls, as a truck has lashing points. Everything else is
drawn: sizes, mass, obstacles on the ground or under the ceiling, where box and modules stand, the
goal, joint speeds, whether the box may arrive with some speed. Nothing looks at what a planner can
do: only rooms in which things overlap are drawn again.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from climbplan.errors import SpecError
from climbplan.limms.schema.loading import LoadedLimms, limms_of
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml

GOALS = ("near", "far", "high")
MODULES = (1, 2, 3, 4)
MOST_OBSTACLES = 3
MASS = (0.2, 2.0)  # [kg], drawn evenly in its logarithm
SPEEDS = (0.0, 1.5)  # [m/s] at which the box may arrive
_ROBOTS = ("limms", "limms_quick")
_ROOM = ((2.2, 3.4), (1.5, 2.0), (1.7, 2.3))  # [m] length, width and height
_SIZE = (0.14, 0.28)  # [m] edges of the box
_ANCHORS = ((0.5, 0.8), (0.5, 0.9))  # [m] apart along a wall, height of the row
_OBSTACLE = ((0.1, 0.4), (0.1, 0.5), (0.15, 0.6))  # [m] edges
_HANGING = 0.25  # share of obstacles under the ceiling
_AWAY = {"near": (0.2, 0.5), "far": (0.7, 1.6), "high": (0.0, 0.5)}  # [m] of the goal, flat
_RISE = {"near": (0.0, 0.4), "far": (0.0, 0.3), "high": (0.7, 1.3)}  # [m] of the goal
_EDGE = 0.08  # [m] of modules and box from walls, at the start


def random_room(seed: int, turned: bool = False) -> LoadedLimms:
    """A room of the kind `kind_of(seed)`; the same for the same seed.

    turned: the same room, with a yaw of the goal that its own generator draws.
    """
    rng = np.random.default_rng(seed)
    name = f"random_room_{seed}"
    while (room := _room(_text(rng, seed), name)) is None:
        continue
    if not turned:
        return room
    yaws = np.random.default_rng([seed, 1])
    while (found := _room(_with_yaw(room.text, yaws.uniform(-180, 180)), f"turned_{name}")) is None:
        continue
    return found


def _room(text: str, name: str) -> LoadedLimms | None:
    """The room, or None where something overlaps."""
    try:
        return limms_of(parse_yaml(text, name), SourceText(name, name, Path.cwd(), text))
    except SpecError:
        return None


def _with_yaw(text: str, yaw: float) -> str:
    """The text of a room whose goal is turned [deg]."""
    titled = re.sub(r"^title: .*", r"\g<0>, turned", text, flags=re.MULTILINE)
    return titled.replace("\nmodules:", f"\n  goal_yaw_deg: {yaw:.1f}\nmodules:")


def kind_of(seed: int) -> str:
    """Where the goal is: kinds take turns."""
    return GOALS[seed % len(GOALS)]


def _text(rng: np.random.Generator, seed: int) -> str:
    room = [rng.uniform(*span) for span in _ROOM]
    half = [room[0] / 2, room[1] / 2]
    size = np.round(rng.uniform(*_SIZE, 3), 3)
    kind = kind_of(seed)
    start = _place(rng, half, size[:2] / 2)
    away, turn = rng.uniform(*_AWAY[kind]), rng.uniform(0, 2 * np.pi)
    goal = start + away * np.array([np.cos(turn), np.sin(turn)])
    rise = rng.uniform(*_RISE[kind])
    mass = float(np.exp(rng.uniform(*np.log(MASS))))
    count = int(rng.choice(MODULES))
    modules = "".join(
        f"\n  - {{name: {name}, position: {_row([*_place(rng, half, np.zeros(2)), 0.0])}}}"
        for name in "ABCD"[:count]
    )
    anchors = "".join(
        f"\n    - {{name: {name}, position: {_row([x, y, z])}, normal: [0, {-np.sign(y):g}, 0]}}"
        for name, (x, y, z) in _anchors(rng, half)
    )
    obstacles = "".join(
        f"\n    - {{name: block {i}, lower: {_row(low)}, upper: {_row(high)}}}"
        for i, (low, high) in enumerate(_obstacles(rng, half, room[2]))
    )
    low = _row([-half[0], -half[1], 0.0])
    return f"""kind: limms
title: goal {kind}
robot: {rng.choice(_ROBOTS)}
terrain:
  friction: 0.8
  regions:
    - {{name: room, lower: {low}, upper: {_row([*half, room[2]])}}}
  obstacles:{obstacles or " []"}
  anchors:{anchors}
box:
  size: {_row(size)}
  mass: {mass:.3f}
  start: {_row([*start, size[2] / 2], 6)}
  goal: {_row([*goal, size[2] / 2 + rise], 6)}
  arrival_speed: {rng.choice(SPEEDS)}
modules:{modules}
seed: {seed}
"""


def _place(rng: np.random.Generator, half: list[float], room: np.ndarray) -> np.ndarray:
    """A point of the ground (2,) that leaves `room` (2,) and an edge to the walls [m]."""
    most = np.array(half) - room - _EDGE
    return rng.uniform(-most, most)


def _anchors(
    rng: np.random.Generator, half: list[float]
) -> list[tuple[str, tuple[float, float, float]]]:
    """A row of anchors on each long wall."""
    found = []
    for side, y in (("left", half[1]), ("right", -half[1])):
        apart, height = (rng.uniform(*span) for span in _ANCHORS)
        first = -half[0] + rng.uniform(0.1, apart)
        places = np.arange(first, half[0] - 0.1, apart)
        found += [(f"{side} {i}", (float(x), y, height)) for i, x in enumerate(places)]
    return found


def _obstacles(
    rng: np.random.Generator, half: list[float], height: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lower and upper corners of up to three blocks."""
    found = []
    for _ in range(rng.integers(MOST_OBSTACLES + 1)):
        size = np.array([rng.uniform(*span) for span in _OBSTACLE])
        flat = rng.uniform(-np.array(half), np.array(half) - size[:2])
        bottom = height - size[2] if rng.random() < _HANGING else 0.0
        low = np.array([*flat, bottom])
        found.append((low, low + size))
    return found


def _row(values: list[float] | np.ndarray, digits: int = 4) -> str:
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"
