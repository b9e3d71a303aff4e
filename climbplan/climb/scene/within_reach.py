"""Surfaces and free regions that limbs and body can reach within some rounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.model import Terrain
from climbplan.terrain.nearest import beyond_bounds


def restrict_terrain(scene: ClimbScene, count: int) -> Terrain:
    """Return the terrain with only the alternatives that some limb can reach in `count` rounds."""
    terrain = scene.terrain
    if terrain.is_curved:
        return terrain
    max_travel = count * scene.spec.posture.steps.com_max
    choices = tuple(
        tuple(f for f in choice if float((f.A @ scene.start.com - f.b).max()) <= max_travel)
        or choice
        for choice in terrain.free_choices
    )
    allowed = np.asarray(np.any(find_reachable_surfaces(scene, count), axis=0), bool)
    limbs = np.arange(len(allowed))
    allowed[limbs, scene.start.region] = True
    return replace(terrain, allowed=allowed, free_choices=choices)


def find_usable_surfaces(scene: ClimbScene) -> BoolArray:
    """Return whether (M, N, R) limb i can reach surface r by the end of round j and still the goal.

    Nothing that a plan could use is excluded.
    """
    count = scene.spec.task.round_count
    is_reachable = find_reachable_surfaces(scene, count)
    tolerance, steps = scene.spec.task.goal.tolerance, scene.spec.posture.steps
    remaining_rounds = np.arange(count - 1, -1, -1)[:, None]
    limbs = len(scene.goal.toes)
    robot = scene.robot
    shoulder = np.linalg.norm(robot.shoulder_body, axis=1)
    com = np.broadcast_to(scene.goal.com, scene.goal.toes.shape)
    distance_limits = [
        (scene.goal.toes, tolerance + remaining_rounds * steps.toe_max + np.zeros(limbs)),
        (com, tolerance + remaining_rounds * steps.com_max + shoulder + robot.reach),
    ]
    can_return = np.ones_like(is_reachable)
    for places, max_distance in distance_limits:
        can_return &= beyond_bounds(scene.terrain.bounds, places) <= max_distance[:, :, None]
    is_usable = is_reachable & can_return
    nowhere = ~is_usable.any(axis=2)  # the program says what is out of reach
    is_usable[nowhere] = np.broadcast_to(scene.terrain.allowed, is_reachable.shape)[nowhere]
    return is_usable


def find_reachable_surfaces(scene: ClimbScene, count: int) -> BoolArray:
    """Return whether (M, N, R) limb i can reach surface r by the end of round j.

    Nothing that a plan could use is excluded. Excluded is only what is further from a toe than its
    steps allow, from the body than its steps and the limb's reach together, or from the limb's
    possible stances than its workspace.
    """
    terrain, robot, spec = scene.terrain, scene.robot, scene.spec.posture
    start, steps = scene.start, spec.steps
    rounds = np.arange(1, count + 1)[:, None]
    stance_distance = np.linalg.norm(robot.stance_body, axis=1)
    turn = np.sqrt(3) * np.minimum(
        rounds * np.deg2rad(steps.rotation_max_deg), 2 * np.deg2rad(spec.rotation_limit_deg)
    )
    tilt = float(np.linalg.norm(start.rpy[:2]))  # by which turns to first order are off
    shoulder = np.linalg.norm(robot.shoulder_body, axis=1)
    nominal = start.com + robot.stance_body @ rotation_world_body(start.rpy).T
    distance_limits = [
        (start.toes, rounds * steps.toe_max + np.zeros(len(stance_distance))),
        (
            np.broadcast_to(start.com, nominal.shape),
            rounds * steps.com_max + shoulder + robot.reach,
        ),
    ]
    if spec.stance_workspace:
        stance_radius = robot.stance_radius + stance_distance * (turn + tilt**2)
        distance_limits.append((nominal, rounds * steps.com_max + stance_radius))
    is_reachable = np.broadcast_to(terrain.allowed, (count, *terrain.allowed.shape)).copy()
    for places, max_distance in distance_limits:
        distance = beyond_bounds(terrain.bounds, places)
        is_reachable &= distance <= max_distance[:, :, None]
    return is_reachable


DEFAULT_WINDOW = 4  # rounds, where the spec leaves both them and their number open


def select_window(scene: ClimbScene) -> int | None:
    """Return the number of rounds of a window; None where all rounds are planned at once."""
    window, rounds = scene.spec.solver.window, scene.spec.task.rounds
    if rounds == "auto":
        return DEFAULT_WINDOW if window is None else window
    return None if window is None or window >= rounds else window
