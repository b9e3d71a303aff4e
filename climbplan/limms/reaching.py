"""Modules on their own: driving on the ground, and bringing a free end to an anchor.

One module moves at a time, while all else rests. Ways are straight in joint space where that is
free, else found by random trees; the last centimetres to an anchor run along its normal.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from climbplan.limms.chain import (
    BRANCHES,
    Points,
    Pose,
    continued,
    forward,
    from_last,
    in_range,
    inverse,
)
from climbplan.limms.contact import gap_between, gap_to_blocks, gap_within, link_segments
from climbplan.limms.rrt import connect
from climbplan.limms.scene import Array
from climbplan.limms.timeline import Progress, samples
from climbplan.spec.limms_module import ModuleSpec

MARGIN = 0.004  # [m] kept on the way
LENGTHS = (0.08, 0.05, 0.03, 0.015)  # [m] of the straight way along the normal of an anchor
SPEED_SHARE = 0.95
_STEP = 0.06  # [rad] between the poses that are looked at
_JUMP = 0.2  # [rad] between samples of a straight way, a few millimetres apart
_TURN = np.pi  # [rad] of a roll that trees look through


class Blocked(Exception):
    """No free way was found; says for whom and where to."""


def gaps(world: Progress, module: int, points: Points, root_end: int | None = None) -> Array:
    """Least gap (n) of a module's poses from solids, boxes, other modules and itself [m].

    root_end: the end that is fixed; its link does not move, and touches what it stands on.
    """
    scene, radius = world.scene, world.scene.module.radius
    segments = link_segments(points, radius)
    half = scene.box_size / 2
    centres = np.vstack([world.box, scene.box_start[1:]])
    lower = np.vstack([scene.solids[:, 0], centres - half])
    upper = np.vstack([scene.solids[:, 1], centres + half])
    moving = segments
    if root_end is not None:
        moving = segments[..., 1:, :, :] if root_end == 0 else segments[..., :3, :, :]
    found = [
        gap_to_blocks(moving, lower, upper, radius).min(axis=(-1, -2)),
        gap_within(segments, radius).min(axis=-1),
    ]
    found += [
        gap_between(moving, world.segments(other), radius).min(axis=(-1, -2))
        for other in range(scene.count)
        if other != module
    ]
    worst: Array = np.min(found, axis=0)
    return worst


def rooted(world: Progress, root: Pose, root_end: int, angles: Array) -> Points:
    """Poses (n) of a module with one end fixed."""
    shape = angles.shape[:-1]
    base = Pose(
        np.broadcast_to(root.position, (*shape, 3)),
        np.broadcast_to(root.rotation, (*shape, 3, 3)),
    )
    place = forward if root_end == 0 else from_last
    return place(world.scene.module, base, angles)


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


def _free_of(
    world: Progress, module: int, root: Pose, root_end: int, margin: float
) -> Callable[[Array], NDArray[np.bool_]]:
    """Which joint angles (n, 6) [rad] are in range and `margin` [m] off everything."""

    def free(angles: Array) -> NDArray[np.bool_]:
        ok = in_range(world.scene.module, angles, 1e-3) <= 0
        if ok.any():
            points = rooted(world, root, root_end, angles[ok])
            ok[ok] = gaps(world, module, points, root_end) >= margin
        return np.asarray(ok)

    return free


def move_joints(
    world: Progress,
    module: int,
    root: Pose,
    root_end: int,
    goal: Array,
    name: str,
    rng: np.random.Generator,
    margin: float = MARGIN,
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
    path = connect(start, goal, lower, upper, free, _STEP, rng)
    if path is None:
        raise Blocked(f"{name}: no free way for module {scene.module_names[module]}")
    time, angles, rates = _smooth(path, SPEED_SHARE * scene.module.max_joint_speed)
    add_motion(world, module, rooted(world, root, root_end, angles), time, angles, rates, name)


def add_motion(
    world: Progress,
    module: int,
    points: Points,
    time: Array,
    angles: Array,
    rates: Array,
    name: str,
) -> None:
    """Add a motion of one module while all else rests."""
    moving = world.rest(name, time)
    moving.place(module, Pose(points.position[:, 0], points.rotation[:, 0]), angles, rates)
    world.add(moving)


def straight_in(
    world: Progress,
    module: int,
    root: Pose,
    root_end: int,
    target: Pose,
    ending: Array,
    length: float,
) -> Array | None:
    """Angles (n, 6) along an anchor's normal into it, ending at `ending`; None where it fails.

    target: pose of the free end when it is latched; its z axis is along the module.
    """
    scene = world.scene
    free_end = 1 - root_end
    inward = target.rotation[:, 2] if free_end == 1 else -target.rotation[:, 2]
    share = np.linspace(0, 1, 25)
    positions = target.position - length * (1 - share)[:, None] * inward
    shape = (len(share), 3, 3)
    moving = Pose(positions, np.broadcast_to(target.rotation, shape))
    still = Pose(
        np.broadcast_to(root.position, positions.shape), np.broadcast_to(root.rotation, shape)
    )
    first, last = (still, moving) if free_end == 1 else (moving, still)
    backwards = continued(
        scene.module,
        Pose(first.position[::-1], first.rotation),
        Pose(last.position[::-1], last.rotation),
        ending,
    )
    best = backwards.angles[::-1]
    if backwards.missing.max() > 0 or np.abs(best[-1] - ending).max() > 1e-3:
        return None
    if in_range(scene.module, best).max() > 0 or np.abs(np.diff(best, axis=0)).max() > _JUMP:
        return None
    clear = gaps(world, module, rooted(world, root, root_end, best), root_end)
    return None if clear.min() < -1e-9 else best


def reach(
    world: Progress,
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
    for length in LENGTHS:
        last = straight_in(world, module, root, root_end, target, ending, length)
        if last is not None:
            begin = rooted(world, root, root_end, last[:1])
            if gaps(world, module, begin, root_end)[0] >= MARGIN:
                break
    else:
        raise Blocked(f"{name}: no free straight end of the way")
    before = last[0]
    now = rooted(world, root, root_end, world.angles[module][None])
    if gaps(world, module, now, root_end)[0] < MARGIN:
        # It stands or hangs closer to something than the ways keep: leave that first
        leave(world, module, root, root_end, name)
    move_joints(world, module, root, root_end, before, name, rng)
    follow(world, module, root, root_end, last, name)


def leave(world: Progress, module: int, root: Pose, root_end: int, name: str) -> None:
    """Draw the free end back along its own axis.

    Raises:
        Blocked: something is in the way.
    """
    free_end = 7 if root_end == 0 else 0
    points = world.points(module)
    pose = Pose(points.position[free_end], points.rotation[free_end])
    for length in LENGTHS:
        path = straight_in(world, module, root, root_end, pose, world.angles[module], length)
        if path is not None:
            follow(world, module, root, root_end, path[::-1], name)
            return
    raise Blocked(f"{name}: module {world.scene.module_names[module]} cannot draw back")


def follow(world: Progress, module: int, root: Pose, root_end: int, path: Array, name: str) -> None:
    """Add a motion of one module whose free end moves straight, through angles (n, 6).

    Its frame is solved anew at every sample, so that it stays on its line.
    """
    scene = world.scene
    ends = rooted(world, root, root_end, path[[0, -1]])
    free_end = 7 if root_end == 0 else 0
    rotation = ends.rotation[0, free_end]
    most = SPEED_SHARE * scene.module.max_joint_speed
    turning = float(np.abs(np.diff(path, axis=0)).max(axis=1).max() * (len(path) - 1))
    duration = max(1.6 * turning / most, 0.1)
    t = samples(duration)
    s = t / duration
    share = (3 * s**2 - 2 * s**3)[:, None]
    positions = ends.position[0, free_end] + share * (
        ends.position[1, free_end] - ends.position[0, free_end]
    )
    shape = (len(t), 3, 3)
    moving = Pose(positions, np.broadcast_to(rotation, shape))
    still = Pose(
        np.broadcast_to(root.position, positions.shape), np.broadcast_to(root.rotation, shape)
    )
    first, last = (still, moving) if free_end == 7 else (moving, still)
    angles = continued(scene.module, first, last, path[0]).angles
    rates = rates_of(t, angles)
    rates[[0, -1]] = 0.0
    add_motion(world, module, rooted(world, root, root_end, angles), t, angles, rates, name)


def closest_branch(module: ModuleSpec, first: Pose, last: Pose, begin: Array, end: Array) -> Array:
    """Angles (n, 6) of the branch that runs nearest from `begin` to `end`."""
    best, error = None, np.inf
    for branch in BRANCHES:
        angles = np.unwrap(inverse(module, first, last, branch).angles, axis=0)
        angles = angles + np.round((begin - angles[0]) / (2 * np.pi)) * 2 * np.pi
        off = float(max(np.abs(angles[0] - begin).max(), np.abs(angles[-1] - end).max()))
        if off < error:
            best, error = angles, off
    assert best is not None
    return best


def rates_of(time: Array, angles: Array) -> Array:
    """Joint speeds (n, ...) of densely sampled angles, by a spline through them."""
    from scipy.interpolate import CubicSpline

    if len(time) < 4:
        return np.gradient(angles, time, axis=0)
    rates: Array = CubicSpline(time, angles, axis=0).derivative()(time)
    return rates


def drive(world: Progress, module: int, goal: Array, name: str, rng: np.random.Generator) -> None:
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

    def free(flat: Array) -> NDArray[np.bool_]:
        places = np.column_stack([flat, np.full(len(flat), start[2])])
        ground = np.zeros(len(flat), bool)
        for patch in scene.patches:
            if abs(patch.height - start[2]) < 1e-6:
                ground |= patch.inside(places, scene.module.radius)
        if ground.any():
            ground[ground] = gaps(world, module, points(places[ground])) >= -1e-6
        return ground

    low = np.min([p.lower for p in scene.patches], axis=0)
    high = np.max([p.upper for p in scene.patches], axis=0)
    path = connect(start[:2], goal[:2], low, high, free, 0.02, rng)
    if path is None:
        raise Blocked(f"{name}: no free way on the ground")
    corners = np.column_stack([path, np.full(len(path), start[2])])
    times, places = [np.zeros(1)], [corners[:1]]
    for first, last in itertools.pairwise(corners):
        length = float(np.linalg.norm(last - first))
        if length < 1e-9:
            continue
        t = samples(1.5 * length / (SPEED_SHARE * scene.module.ground_speed))
        s = t / t[-1]
        times.append(times[-1][-1] + t[1:])
        places.append(first + (3 * s**2 - 2 * s**3)[1:, None] * (last - first))
    time, place = np.concatenate(times), np.concatenate(places)
    if len(time) < 2:
        return
    still = np.tile(angles, (len(time), 1))
    add_motion(world, module, points(place), time, still, np.zeros_like(still), name)
