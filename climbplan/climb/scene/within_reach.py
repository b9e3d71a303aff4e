"""What of a terrain limbs and body can come to in some rounds: the alternatives of a window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.model import Terrain
from climbplan.terrain.nearest import beyond_bounds


def within_rounds(scene: ClimbScene, count: int) -> Terrain:
    """The terrain with only those alternatives that some limb can come to in so many rounds."""
    terrain = scene.terrain
    if terrain.is_curved:
        return terrain
    body = count * scene.spec.posture.steps.com_max
    choices = tuple(
        tuple(f for f in choice if float((f.A @ scene.start.com - f.b).max()) <= body) or choice
        for choice in terrain.free_choices
    )
    allowed = np.asarray(np.any(reachable(scene, count), axis=0), bool)
    limbs = np.arange(len(allowed))
    allowed[limbs, scene.start.region] = True
    return replace(terrain, allowed=allowed, free_choices=choices)


def between(scene: ClimbScene) -> BoolArray:
    """(M, N, R) whether limb i can come to surface r by the end of round j and on to the goal.

    What a guide of the body is to other planners: again nothing that a plan could use is left out,
    but what no plan could leave behind in the rounds that remain.
    """
    count = scene.spec.task.round_count
    found = reachable(scene, count)
    tolerance, steps = scene.spec.task.goal.tolerance, scene.spec.posture.steps
    left = np.arange(count - 1, -1, -1)[:, None]
    limbs = len(scene.goal.toes)
    robot = scene.robot
    shoulder = np.linalg.norm(robot.shoulder_body, axis=1)
    com = np.broadcast_to(scene.goal.com, scene.goal.toes.shape)
    far = [
        (scene.goal.toes, tolerance + left * steps.toe_max + np.zeros(limbs)),
        (com, tolerance + left * steps.com_max + shoulder + robot.reach),
    ]
    back = np.ones_like(found)
    for places, most in far:
        back &= beyond_bounds(scene.terrain.bounds, places) <= most[:, :, None]
    both = found & back
    nowhere = ~both.any(axis=2)  # the program says what is out of reach
    both[nowhere] = np.broadcast_to(scene.terrain.allowed, found.shape)[nowhere]
    return both


def reachable(scene: ClimbScene, count: int) -> BoolArray:
    """(M, N, R) whether limb i can come to surface r by the end of round j.

    Nothing that a plan of these rounds could use is left out: only what is further from a toe than
    its steps go, from the body than its steps and the limb's reach together, or from where the
    limb's stance can be than its workspace.
    """
    terrain, robot, spec = scene.terrain, scene.robot, scene.spec.posture
    start, steps = scene.start, spec.steps
    rounds = np.arange(1, count + 1)[:, None]
    size = np.linalg.norm(robot.stance_body, axis=1)
    turn = np.sqrt(3) * np.minimum(
        rounds * np.deg2rad(steps.rotation_max_deg), 2 * np.deg2rad(spec.rotation_limit_deg)
    )
    tilt = float(np.linalg.norm(start.rpy[:2]))  # by which turns to first order are off
    shoulder = np.linalg.norm(robot.shoulder_body, axis=1)
    nominal = start.com + robot.stance_body @ rotation_world_body(start.rpy).T
    far = [
        (start.toes, rounds * steps.toe_max + np.zeros(len(size))),
        (
            np.broadcast_to(start.com, nominal.shape),
            rounds * steps.com_max + shoulder + robot.reach,
        ),
    ]
    if spec.stance_workspace:
        room = robot.stance_radius + size * (turn + tilt**2)
        far.append((nominal, rounds * steps.com_max + room))
    found = np.broadcast_to(terrain.allowed, (count, *terrain.allowed.shape)).copy()
    for places, most in far:
        away = beyond_bounds(terrain.bounds, places)
        found &= away <= most[:, :, None]
    return found


WINDOW = 4  # rounds, where the spec leaves both them and their number open


def window_of(scene: ClimbScene) -> int | None:
    """Rounds of a window; None where all rounds are planned at once."""
    window, rounds = scene.spec.solver.window, scene.spec.task.rounds
    if rounds == "auto":
        return WINDOW if window is None else window
    return None if window is None or window >= rounds else window
