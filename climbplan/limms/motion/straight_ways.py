"""Straight ways of a module's free end, along its own axis: into an anchor, and out of it."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from climbplan.arrays import Array
from climbplan.limms.modules.chain import BRANCHES, continued, in_range, inverse
from climbplan.limms.motion.moving import Blocked, add_motion, gaps, rooted
from climbplan.limms.motion.timeline import PartialPlan, samples
from climbplan.limms.scene.limms_scene import Pose
from climbplan.limms.schema.module import ModuleSpec

LENGTH_ROWS = (0.08, 0.05, 0.03, 0.015)  # [m] of the straight way along the normal of an anchor
SPEED_SHARE = 0.95
_JUMP = 0.2  # [rad] between samples of a straight way, a few millimetres apart


def straight_in(
    world: PartialPlan,
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


def leave(world: PartialPlan, module: int, root: Pose, root_end: int, name: str) -> None:
    """Draw the free end back along its own axis.

    Raises:
        Blocked: something is in the way.
    """
    free_end = 7 if root_end == 0 else 0
    points = world.points(module)
    pose = Pose(points.position[free_end], points.rotation[free_end])
    for length in LENGTH_ROWS:
        path = straight_in(world, module, root, root_end, pose, world.angles[module], length)
        if path is not None:
            follow(world, module, root, root_end, path[::-1], name)
            return
    raise Blocked(f"{name}: module {world.scene.module_names[module]} cannot draw back")


def follow(
    world: PartialPlan, module: int, root: Pose, root_end: int, path: Array, name: str
) -> None:
    """Add a motion of one module whose free end moves straight, through angles (n, 6).

    Its frame is solved anew at every sample, so that it stays on its line.
    """
    scene = world.scene
    ends = rooted(world, root, root_end, path[[0, -1]])
    free_end = 7 if root_end == 0 else 0
    rotation = ends.rotation[0, free_end]
    most = scene.pace * SPEED_SHARE * scene.module.max_joint_speed
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
    if len(time) < 4:
        return np.gradient(angles, time, axis=0)
    rates: Array = CubicSpline(time, angles, axis=0).derivative()(time)
    return rates
