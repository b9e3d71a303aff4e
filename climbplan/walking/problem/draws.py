"""Random starts of a walk: the published ranges, and disturbances beyond them; random worlds.

Published (8.2.4.5) are a forward velocity within 1.5 m/s and a forward acceleration within 15 m/s^2
either way. An acceleration is no part of a rigid body's state: it is taken for a push through the
knot before the plan, which begins at v_x + a_x dt with the toes under the body.

A world is a robot that is heavier or lighter than the file's, a reference that is faster or slower
than the task's, and treads across the way, each higher or lower than the one before, ahead of a
floor that the robot starts on and behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.problem.problem import ground_under
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY, Start, WalkTask

TREADS = 4  # on either side of the floor; the last ones have no end
WORLD = 2 + 4 * TREADS  # numbers of a world
_FLOOR = 0.25  # [m] from its middle, where the body starts, to the first tread
_FAR = 1e3  # [m]


@dataclass(frozen=True)
class StartRanges:
    """How far starts are drawn either way; the published ranges alone if left out."""

    forward: float = 1.5  # [m/s] v_x
    acceleration: float = 15.0  # [m/s^2] a_x, through one knot
    sideways: float = 0.0  # [m/s]
    tilt: float = 0.0  # [rad] roll and pitch
    yaw: float = 0.0  # [rad]
    spin: float = 0.0  # [rad/s] of each component
    toes: float = 0.0  # [m] of each toe along x and y


@dataclass(frozen=True)
class WorldRanges:
    """What robots, references and ground are drawn from; if left out they are as they were."""

    mass: float = 0.0  # share of the mass either way; inertia goes with it
    speed: tuple[float, float] | None = None  # share of the reference's velocity, from and to
    rise: float = 0.0  # [m] from a tread to the next, up or down
    tread: tuple[float, float] = (0.2, 0.5)  # [m] lengths of treads

    @property
    def drawn(self) -> bool:
        """Something is drawn at all."""
        return self.mass > 0 or self.rise > 0 or self.speed is not None


@dataclass(frozen=True)
class DrawnStart:
    """A task from a random start, and what was drawn."""

    task: WalkTask
    forward: float  # [m/s]
    acceleration: float  # [m/s^2]
    world: Array  # (WORLD,) as of `in_world`; (0,) where none is drawn


def drawn_start(task: WalkTask, ranges: StartRanges, rng: np.random.Generator) -> DrawnStart:
    """The task from another start: what is drawn takes the place of its velocity and spin."""

    def either_way(size: float, count: int) -> np.ndarray:
        return size * rng.uniform(-1.0, 1.0, count)

    forward = float(either_way(ranges.forward, 1)[0])
    acceleration = float(either_way(ranges.acceleration, 1)[0])
    state = task.start.state.copy()
    sideways = float(either_way(ranges.sideways, 1)[0])
    state[VELOCITY] = [forward + task.step * acceleration, sideways, 0.0]
    state[ANGLES] += np.concatenate([either_way(ranges.tilt, 2), either_way(ranges.yaw, 1)])
    state[SPIN] = either_way(ranges.spin, 3)
    toes = task.start.toes.copy()
    toes[:, :2] += either_way(ranges.toes, toes[:, :2].size).reshape(-1, 2)
    started = replace(task, start=Start(state, toes))
    return DrawnStart(started, forward, acceleration, np.empty(0))


def drawn_world(drawn: DrawnStart, ranges: WorldRanges, rng: np.random.Generator) -> DrawnStart:
    """The drawn start on flat ground in a random world, with its toes on the ground."""
    if not ranges.drawn:
        return drawn
    sides = (2, TREADS)
    far = _FLOOR + np.cumsum(rng.uniform(*ranges.tread, sides), axis=1)
    far = np.column_stack([np.full(2, _FLOOR), far[:, :-1]])
    level = np.cumsum(ranges.rise * rng.uniform(-1.0, 1.0, sides), axis=1)
    factor = 1.0 + ranges.mass * rng.uniform(-1.0, 1.0)
    speed = 1.0 if ranges.speed is None else rng.uniform(*ranges.speed)
    world = np.concatenate([[factor, speed], far.ravel(), level.ravel()])
    task = in_world(drawn.task, world)
    return replace(drawn, task=task, world=world)


def in_world(task: WalkTask, world: Array) -> WalkTask:
    """A task on flat ground in a world: its body, ground, toes, velocity and heights it follows.

    world (WORLD,): factor of mass and inertia; factor of the reference's velocity; where treads
    begin, ahead and behind (2, TREADS) [m from the origin]; how high they are, in that order [m].
    Nothing changes for (0,).
    """
    if not len(world):
        return task
    factor, (far, level) = float(world[0]), world[2:].reshape(2, 2, TREADS)
    body = replace(task.body, mass=factor * task.body.mass, inertia=factor * task.body.inertia)
    followed = replace(task.reference, velocity=float(world[1]) * task.reference.velocity)
    task = replace(task, body=body, reference=followed)
    if not level.any():
        return task
    ahead, behind = np.append(far[0], _FAR), np.append(far[1], _FAR)
    x = np.concatenate([-behind[::-1], ahead])
    height = np.concatenate([level[1, ::-1], [0.0], level[0]])
    low = np.column_stack([x[:-1], np.full(len(height), -_FAR)])
    high = np.column_stack([x[1:], np.full(len(height), _FAR)])
    names = tuple(f"tread {k - TREADS}" for k in range(len(height)))
    flat = Ground.level(names, low, high, height, task.ground.friction)
    ground = replace(flat, edge=task.ground.edge)
    region = ground.nearest(task.start.toes[:, :2])
    xy = ground.into(region, task.start.toes[:, :2])
    toes = np.column_stack([xy, ground.level_at(region, xy)])
    reference, start = task.reference, task.start.state
    way = start[POSITION][:2] + np.cumsum(task.steps[:, None] * reference.velocity[:, :2], axis=0)
    below = ground_under(ground, body, way, reference.euler[0])
    return replace(
        task,
        ground=ground,
        start=Start(start, toes),
        reference=replace(reference, height=reference.height + below),
    )
