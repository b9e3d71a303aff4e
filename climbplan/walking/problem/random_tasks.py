"""Random walking tasks: starts in the published ranges, disturbances, robots and terrain.

X. Lin (UCLA 2022, chapter 8.2.4.5) draws forward velocities within 1.5 m/s and forward
accelerations within 15 m/s^2, either way. An acceleration is no part of a rigid body's state. It
acts as a push through the knot before the plan, which begins at v_x + a_x dt with the toes under
the body.

A world has a robot of another mass, a reference of another speed, and treads across the path. Each
tread is higher or lower than the one before, ahead of the floor of the start and behind it.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.problem.problem import compute_ground_height
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY, Start, WalkTask

NUM_TREADS = 4  # on either side of the floor; the last ones are unbounded
WORLD_SIZE = 2 + 4 * NUM_TREADS  # parameters
_FLOOR_HALF_LENGTH = 0.25  # [m] from the start to the first tread
_FAR = 1e3  # [m]


@dataclass(frozen=True)
class StartRanges:
    """Half ranges of random starts; the published ranges by default."""

    forward: float = 1.5  # [m/s] v_x
    acceleration: float = 15.0  # [m/s^2] a_x, through one knot
    lateral: float = 0.0  # [m/s] v_y
    tilt: float = 0.0  # [rad] roll and pitch
    yaw: float = 0.0  # [rad]
    angular_velocity: float = 0.0  # [rad/s] of each component
    toes: float = 0.0  # [m] of each toe along x and y


@dataclass(frozen=True)
class WorldRanges:
    """Ranges of robots, references and terrain; nothing is random by default."""

    mass: float = 0.0  # relative half range of mass and inertia
    speed: tuple[float, float] | None = None  # factors of the reference's velocity, from and to
    rise: float = 0.0  # [m] from a tread to the next, up or down
    tread: tuple[float, float] = (0.2, 0.5)  # [m] lengths of treads

    @property
    def is_random(self) -> bool:
        """True if anything is random."""
        return self.mass > 0 or self.rise > 0 or self.speed is not None


@dataclass(frozen=True)
class SampledStart:
    """A task from a random start, and its random parameters."""

    task: WalkTask
    forward: float  # [m/s]
    acceleration: float  # [m/s^2]
    world: Array  # (WORLD_SIZE,) as for `apply_world`; (0,) without a random world


def sample_start(task: WalkTask, ranges: StartRanges, rng: np.random.Generator) -> SampledStart:
    """Sample the start: velocity and angular velocity are replaced, the rest is disturbed."""

    def either_way(size: float, count: int) -> np.ndarray:
        return size * rng.uniform(-1.0, 1.0, count)

    forward = float(either_way(ranges.forward, 1)[0])
    acceleration = float(either_way(ranges.acceleration, 1)[0])
    state = task.start.state.copy()
    lateral = float(either_way(ranges.lateral, 1)[0])
    state[VELOCITY] = [forward + task.dt * acceleration, lateral, 0.0]
    state[ANGLES] += np.concatenate([either_way(ranges.tilt, 2), either_way(ranges.yaw, 1)])
    state[SPIN] = either_way(ranges.angular_velocity, 3)
    toes = task.start.toes.copy()
    toes[:, :2] += either_way(ranges.toes, toes[:, :2].size).reshape(-1, 2)
    started = replace(task, start=Start(state, toes))
    return SampledStart(started, forward, acceleration, np.empty(0))


def sample_world(
    start: SampledStart, ranges: WorldRanges, rng: np.random.Generator
) -> SampledStart:
    """Place a sampled start on flat ground in a random world, with its toes on the terrain."""
    if not ranges.is_random:
        return start
    sides = (2, NUM_TREADS)
    tread_start = _FLOOR_HALF_LENGTH + np.cumsum(rng.uniform(*ranges.tread, sides), axis=1)
    tread_start = np.column_stack([np.full(2, _FLOOR_HALF_LENGTH), tread_start[:, :-1]])
    tread_height = np.cumsum(ranges.rise * rng.uniform(-1.0, 1.0, sides), axis=1)
    factor = 1.0 + ranges.mass * rng.uniform(-1.0, 1.0)
    speed = 1.0 if ranges.speed is None else rng.uniform(*ranges.speed)
    world = np.concatenate([[factor, speed], tread_start.ravel(), tread_height.ravel()])
    task = apply_world(start.task, world)
    return replace(start, task=task, world=world)


def apply_world(task: WalkTask, world: Array) -> WalkTask:
    """Apply a world to a task on flat ground: its body, terrain, toes, velocity and heights.

    Args:
        task: on flat ground.
        world: (WORLD_SIZE,) factor of mass and inertia; factor of the reference's velocity; starts
            of treads, ahead and behind (2, NUM_TREADS) [m from the origin]; their heights in that
            order [m]. (0,): nothing changes.
    """
    if not len(world):
        return task
    factor, (tread_start, tread_height) = float(world[0]), world[2:].reshape(2, 2, NUM_TREADS)
    body = replace(task.body, mass=factor * task.body.mass, inertia=factor * task.body.inertia)
    reference_velocity = replace(task.reference, velocity=float(world[1]) * task.reference.velocity)
    task = replace(task, body=body, reference=reference_velocity)
    if not tread_height.any():
        return task
    ahead, behind = np.append(tread_start[0], _FAR), np.append(tread_start[1], _FAR)
    x = np.concatenate([-behind[::-1], ahead])
    height = np.concatenate([tread_height[1, ::-1], [0.0], tread_height[0]])
    low = np.column_stack([x[:-1], np.full(len(height), -_FAR)])
    high = np.column_stack([x[1:], np.full(len(height), _FAR)])
    names = tuple(f"tread {k - NUM_TREADS}" for k in range(len(height)))
    flat = Ground.level(names, low, high, height, task.ground.friction)
    ground = replace(flat, edge=task.ground.edge)
    region = ground.nearest(task.start.toes[:, :2])
    xy = ground.project(region, task.start.toes[:, :2])
    toes = np.column_stack([xy, ground.compute_height(region, xy)])
    reference, start = task.reference, task.start.state
    path = start[POSITION][:2] + np.cumsum(task.steps[:, None] * reference.velocity[:, :2], axis=0)
    terrain_height = compute_ground_height(ground, body, path, reference.euler[0])
    return replace(
        task,
        ground=ground,
        start=Start(start, toes),
        reference=replace(reference, height=reference.height + terrain_height),
    )
