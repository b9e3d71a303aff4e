"""The windows that a long climb may go on by: rounds drawn along the body's way, or to its goal.

Only regions and free space that a limb can come to within a window are alternatives in it, so that
its size does not grow with the terrain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.postures.ways import ways_too_long
from climbplan.climb.scene.climb_scene import ClimbScene, Stance
from climbplan.climb.scene.within_reach import reachable, within_rounds
from climbplan.climb.schema.model import MOST_ROUNDS
from climbplan.climb.windows.body_way import BodyWay
from climbplan.robots.rotations import rotation_world_body

LOOSE_GAP = 0.02  # relative, of windows that are not the last: half of them is planned again
_PACES = (1.0, 0.5)  # shares of what a window's rounds can cover, aimed at in turn
_DRAWN = 0.1  # factor on the weights of toes and angles at a window's end that is not the goal
_CATCHING_UP = 4.0  # factor on the relative lag behind an even pace
_ANYWHERE = 1e3  # [m] tolerance of such an end
_BEYOND = 2e-3  # [m]


@dataclass(frozen=True)
class Behind:
    """What a window goes on from."""

    stance: Stance
    rounds: int  # planned so far
    covered: float  # [m] of the way
    backed: int  # times that rounds were given up because no window went on from them


def next_windows(
    scene: ClimbScene, way: BodyWay, window: int, behind: Behind
) -> Iterator[tuple[ClimbScene, bool]]:
    """Windows to try from where the plan is, and whether they are the last."""
    here = replace(scene, start=behind.stance)
    asked = scene.spec.task.rounds
    most = MOST_ROUNDS if asked == "auto" else int(asked)
    left = most - behind.rounds
    if left <= 0:
        return
    com_max = scene.spec.posture.steps.com_max
    ahead = way.length - behind.covered
    if asked != "auto":
        if left <= window:
            yield _part(here, left), True
            return
        # Windows fall short of what they are drawn to: who is behind is drawn further
        needed, even = ahead / left, max(way.length / most, 1e-9)
        pace = min(needed * (1.0 + _CATCHING_UP * max(needed / even - 1.0, 0.0)), com_max)
        yield _towards(here, way, behind.covered + window * pace, window), False
        return
    least = max([1, *(one.needed for one in ways_too_long(with_rounds(here, 1)))])
    least = max(least, int(np.ceil((ahead - scene.spec.task.goal.tolerance) / com_max - 1e-6)))
    for count in range(least, min(window, left) + 1):
        yield _part(here, count), True
    for pace in _PACES if behind.backed % 2 == 0 else _PACES[::-1]:
        aim = min(behind.covered + pace * window * com_max, way.length)
        yield _towards(here, way, aim, min(window, left)), False


def by_method(scene: ClimbScene, method: str) -> ClimbScene:
    solver = scene.spec.solver.model_copy(update={"method": method})
    return replace(scene, spec=scene.spec.model_copy(update={"solver": solver}))


def with_rounds(scene: ClimbScene, count: int) -> ClimbScene:
    task = scene.spec.task.model_copy(update={"rounds": count})
    return replace(scene, spec=scene.spec.model_copy(update={"task": task}))


def _part(scene: ClimbScene, count: int) -> ClimbScene:
    """A scene of so many rounds, with what of the terrain they can come to.

    Rotations are linearised about each window's own start, so that toes which the window before it
    left at the edge of their stance workspace may be some mm outside it: it is that much larger.
    """
    radius = max(scene.robot.stance_radius, _farthest_of_stance(scene) + _BEYOND)
    robot = replace(scene.robot, stance_radius=radius)
    scene = replace(scene, robot=robot)
    near = within_rounds(scene, count)
    part = replace(with_rounds(scene, count), terrain=near, robot=robot)
    if near.curved:
        return part
    found = reachable(part, count)
    nowhere = ~found.any(axis=2)  # the program says what is out of reach
    found[nowhere] = np.broadcast_to(near.allowed, found.shape)[nowhere]
    return replace(part, by_round=found)


def _farthest_of_stance(scene: ClimbScene) -> float:
    """Largest distance of a toe from its nominal stance at the scene's start [m]."""
    start = scene.start
    nominal = start.com + scene.robot.stance_body @ rotation_world_body(start.rpy).T
    return float(np.linalg.norm(start.toes - nominal, axis=1).max())


def _towards(scene: ClimbScene, way: BodyWay, aim: float, count: int) -> ClimbScene:
    """A window that is drawn to a place of the way and need not reach it."""
    part = _part(scene, count)
    share = aim / way.length if way.length > 0 else 1.0
    com = way.at(aim)
    first, last = np.array(scene.spec.task.start.rpy_deg), np.array(scene.spec.task.goal.rpy_deg)
    rpy = np.deg2rad(first + share * (last - first))
    goal = _standing_at(part, com, rpy)
    spec = part.spec
    solver = spec.solver.model_copy(update={"gap": max(spec.solver.gap, LOOSE_GAP)})
    loose = spec.task.goal.model_copy(
        update={"tolerance": _ANYWHERE, "rotation_tolerance_deg": 360.0}
    )
    weights = spec.posture.weights
    weights = weights.model_copy(
        update={
            "goal": _DRAWN * weights.goal,
            "goal_rotation": _DRAWN * weights.goal_rotation,
            "goal_com": max(weights.goal_com, weights.goal),
        }
    )
    task = spec.task.model_copy(update={"goal": loose})
    posture = spec.posture.model_copy(update={"weights": weights})
    drawn = spec.model_copy(update={"task": task, "posture": posture, "solver": solver})
    return replace(part, spec=drawn, goal=goal)


def _standing_at(scene: ClimbScene, com: Array, rpy: Array) -> Stance:
    """Toes on the surface points nearest to the nominal stance of a body pose."""
    nominal = com + scene.robot.stance_body @ rotation_world_body(rpy).T
    region = np.array(
        [scene.terrain.nearest_surface(i, point) for i, point in enumerate(nominal)], np.int64
    )
    toes = [scene.terrain.surfaces[r].project(p) for r, p in zip(region, nominal, strict=True)]
    return Stance(com, rpy, np.array(toes), region)
