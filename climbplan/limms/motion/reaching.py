"""Modules on their own: driving on the ground, and bringing a free end to an anchor.

One module moves at a time, while all else rests. Ways are straight in joint space where that is
free, else found by random trees; the last centimetres to an anchor run along its normal.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.modules.chain import forward, in_range
from climbplan.limms.modules.rrt import connect
from climbplan.limms.motion.moving import Blocked, add_motion, gaps, rooted
from climbplan.limms.motion.straight_ways import (
    LENGTH_ROWS,
    SPEED_SHARE,
    follow,
    leave,
    straight_in,
)
from climbplan.limms.motion.timeline import PartialPlan, samples
from climbplan.limms.scene.limms_scene import Points, Pose

GROUND_MARGIN = 0.004  # [m] kept on the way
_DRIVING = 2e-3  # [m] kept while driving
_STEPS = (0.06, 0.02)  # [rad] between the poses that are looked at, the second if need be
_DENSE = 0.01  # [rad] between those by which a way is judged
_TURN = np.pi  # [rad] of a roll that trees look through


def _smooth(corners: Array, most: float) -> tuple[Array, Array, Array]:
    """Times, values and rates along a polyline, at rest at its corners.

    most: largest rate of any coordinate.
    """
    times, values, rates = [np.zeros(1)], [corners[:1]], [np.zeros_like(corners[:1])]
    for first, last in itertools.pairwise(corners):
        duration = max(1.5 * float(np.abs(last - first).max()) / most, 0.02)
        t = samples(duration)
        s = t / duration
        share, slope = 3 * s**2 - 2 * s**3, (6 * s - 6 * s**2) / duration
        times.append(times[-1][-1] + t[1:])
        values.append(first + share[1:, None] * (last - first))
        rates.append(slope[1:, None] * (last - first))
    return np.concatenate(times), np.concatenate(values), np.concatenate(rates)


def _dense(corners: Array) -> Array:
    """Points (n, d) of a polyline, close to each other."""
    parts = [corners[:1]]
    for first, last in itertools.pairwise(corners):
        count = max(int(np.ceil(np.abs(last - first).max() / _DENSE)), 1)
        parts.append(first + np.linspace(0, 1, count + 1)[1:, None] * (last - first))
    return np.concatenate(parts)


def _free_of(
    world: PartialPlan, module: int, root: Pose, root_end: int, margin: float
) -> Callable[[Array], BoolArray]:
    """Which joint angles (n, 6) [rad] are in range and `margin` [m] off everything."""

    def free(angles: Array) -> BoolArray:
        ok = in_range(world.scene.module, angles, 1e-3) <= 0
        if ok.any():
            points = rooted(world, root, root_end, angles[ok])
            ok[ok] = gaps(world, module, points, root_end) >= margin
        return np.asarray(ok)

    return free


def move_joints(
    world: PartialPlan,
    module: int,
    root: Pose,
    root_end: int,
    goal: Array,
    name: str,
    rng: np.random.Generator,
    margin: float = GROUND_MARGIN,
) -> None:
    """Add a motion of one module to joint angles `goal`, its root end fixed.

    Raises:
        Blocked: no free way was found.
    """
    scene = world.scene
    start = world.angles[module]
    limits = np.array(scene.module.joint_range)
    span = np.minimum(limits, _TURN + 0.5)
    lower = np.maximum(np.minimum(start, goal) - span, -limits)
    upper = np.minimum(np.maximum(start, goal) + span, limits)
    free = _free_of(world, module, root, root_end, margin)
    for step in _STEPS:
        path = connect(start, goal, lower, upper, free, step, rng)
        if path is None:
            raise Blocked(f"{name}: no free way for module {scene.module_names[module]}")
        # Between two poses that are looked at an end moves further than it keeps off things
        if gaps(world, module, rooted(world, root, root_end, _dense(path)), root_end).min() >= 0:
            break
    else:
        raise Blocked(f"{name}: module {scene.module_names[module]} passes something too closely")
    time, angles, rates = _smooth(path, scene.pace * SPEED_SHARE * scene.module.max_joint_speed)
    add_motion(world, module, rooted(world, root, root_end, angles), time, angles, rates, name)


def reach(
    world: PartialPlan,
    module: int,
    root: Pose,
    root_end: int,
    target: Pose,
    ending: Array,
    name: str,
    rng: np.random.Generator,
) -> None:
    """Bring the free end of a module into an anchor, ending with angles `ending`.

    Raises:
        Blocked: no free way was found.
    """
    for length in LENGTH_ROWS:
        last = straight_in(world, module, root, root_end, target, ending, length)
        if last is not None:
            begin = rooted(world, root, root_end, last[:1])
            if gaps(world, module, begin, root_end)[0] >= GROUND_MARGIN:
                break
    else:
        raise Blocked(f"{name}: no free straight end of the way")
    before = last[0]
    now = rooted(world, root, root_end, world.angles[module][None])
    if gaps(world, module, now, root_end)[0] < GROUND_MARGIN:
        # It stands or hangs closer to something than the ways keep: leave that first
        leave(world, module, root, root_end, name)
    move_joints(world, module, root, root_end, before, name, rng)
    follow(world, module, root, root_end, last, name)


def drive(
    world: PartialPlan, module: int, goal: Array, name: str, rng: np.random.Generator
) -> None:
    """Drive a module that stands upright to a point of the same ground.

    Raises:
        Blocked: no free way was found.
    """
    scene = world.scene
    start = world.base_position[module]
    angles = world.angles[module]
    rotation = world.base_rotation[module]

    def points(places: Array) -> Points:
        base = Pose(places, np.broadcast_to(rotation, (len(places), 3, 3)))
        return forward(scene.module, base, np.broadcast_to(angles, (len(places), 6)))

    def free(flat: Array) -> BoolArray:
        places = np.column_stack([flat, np.full(len(flat), start[2])])
        ground = np.zeros(len(flat), bool)
        for patch in scene.patches:
            if abs(patch.height - start[2]) < 1e-6:
                ground |= patch.contains(places, scene.module.radius)
        if ground.any():
            ground[ground] = gaps(world, module, points(places[ground])) >= margin
        return ground

    # Between two places that are looked at a corner comes nearer by step^2 / (8 radius), 1.7 mm.
    # Where a module stands closer to something, or is to stand, it is looked at more often
    ends = np.array([start, [*goal[:2], start[2]]])
    near = float(gaps(world, module, points(ends)).min())
    margin, step = (_DRIVING, 0.02) if near >= _DRIVING else (-1e-6, 0.004)

    low = np.min([p.lower for p in scene.patches], axis=0)
    high = np.max([p.upper for p in scene.patches], axis=0)
    path = connect(start[:2], goal[:2], low, high, free, step, rng)
    if path is None:
        raise Blocked(f"{name}: no free way on the ground")
    corners = np.column_stack([path, np.full(len(path), start[2])])
    times, places = [np.zeros(1)], [corners[:1]]
    for first, last in itertools.pairwise(corners):
        length = float(np.linalg.norm(last - first))
        if length < 1e-9:
            continue
        t = samples(1.5 * length / (scene.pace * SPEED_SHARE * scene.module.ground_speed))
        s = t / t[-1]
        times.append(times[-1][-1] + t[1:])
        places.append(first + (3 * s**2 - 2 * s**3)[1:, None] * (last - first))
    time, place = np.concatenate(times), np.concatenate(places)
    if len(time) < 2:
        return
    still = np.tile(angles, (len(time), 1))
    add_motion(world, module, points(place), time, still, np.zeros_like(still), name)
