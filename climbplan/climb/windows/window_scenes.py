"""List the windows that may continue a long climb: along the body's path, or to its goal.

Only regions and free space that a limb can come to within a window are alternatives in it, so that
its size does not grow with the terrain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.postures.travel_distance import find_excessive_travel
from climbplan.climb.scene.climb_scene import ClimbScene, ClimbStance
from climbplan.climb.scene.within_reach import find_reachable_surfaces, restrict_terrain
from climbplan.climb.schema.model import MAX_ROUNDS
from climbplan.climb.windows.body_way import BodyPath
from climbplan.robots.rotations import rotation_world_body

LOOSE_GAP = 0.02  # relative, of windows but the last, as half of each is planned again
_PACE_FRACTIONS = (1.0, 0.5)  # fractions of what a window can cover, as targets in turn
_GOAL_WEIGHT_FACTOR = 0.1  # on the weights of toes and angles at the end of a window but the last
_LAG_GAIN = 4.0  # on the relative lag behind an even pace
_FREE_TOLERANCE = 1e3  # [m] of the end of a window but the last
_RADIUS_MARGIN = 2e-3  # [m]


@dataclass(frozen=True)
class WindowStart:
    """The state from which a window continues."""

    stance: ClimbStance
    rounds: int  # planned so far
    covered: float  # [m] of the way
    num_backtracks: int  # times that rounds were given up because no window went on from them


def list_windows(
    scene: ClimbScene, path: BodyPath, window: int, window_start: WindowStart
) -> Iterator[tuple[ClimbScene, bool]]:
    """List windows to try from the end of the plan, and whether they are the last."""
    current = replace(scene, start=window_start.stance)
    requested = scene.spec.task.rounds
    max_rounds = MAX_ROUNDS if requested == "auto" else int(requested)
    rounds_left = max_rounds - window_start.rounds
    if rounds_left <= 0:
        return
    com_max = scene.spec.posture.steps.com_max
    remaining = path.length - window_start.covered
    if requested != "auto":
        if rounds_left <= window:
            yield _build_window(current, rounds_left), True
            return
        # Windows fall short of what they are drawn to: who is behind is drawn further
        needed, even = remaining / rounds_left, max(path.length / max_rounds, 1e-9)
        pace = min(needed * (1.0 + _LAG_GAIN * max(needed / even - 1.0, 0.0)), com_max)
        yield (
            _build_approaching_window(current, path, window_start.covered + window * pace, window),
            False,
        )
        return
    min_rounds = max(
        [
            1,
            *(
                violation.min_rounds
                for violation in find_excessive_travel(replace_rounds(current, 1))
            ),
        ]
    )
    min_rounds = max(
        min_rounds, int(np.ceil((remaining - scene.spec.task.goal.tolerance) / com_max - 1e-6))
    )
    for count in range(min_rounds, min(window, rounds_left) + 1):
        yield _build_window(current, count), True
    for pace in _PACE_FRACTIONS if window_start.num_backtracks % 2 == 0 else _PACE_FRACTIONS[::-1]:
        target = min(window_start.covered + pace * window * com_max, path.length)
        yield _build_approaching_window(current, path, target, min(window, rounds_left)), False


def replace_method(scene: ClimbScene, method: str) -> ClimbScene:
    """Return the scene with another method of its solver."""
    solver = scene.spec.solver.model_copy(update={"method": method})
    return replace(scene, spec=scene.spec.model_copy(update={"solver": solver}))


def replace_rounds(scene: ClimbScene, count: int) -> ClimbScene:
    """Return the scene with another number of rounds."""
    task = scene.spec.task.model_copy(update={"rounds": count})
    return replace(scene, spec=scene.spec.model_copy(update={"task": task}))


def _build_window(scene: ClimbScene, count: int) -> ClimbScene:
    """Build a scene of some rounds with the terrain that is in reach of them.

    Rotations are linearised about each window's start. Toes that the window before left at the edge
    of their stance workspace may lie outside it by some millimetres, so it is enlarged.
    """
    radius = max(scene.robot.stance_radius, _find_stance_radius(scene) + _RADIUS_MARGIN)
    robot = replace(scene.robot, stance_radius=radius)
    scene = replace(scene, robot=robot)
    terrain = restrict_terrain(scene, count)
    window = replace(replace_rounds(scene, count), terrain=terrain, robot=robot)
    if terrain.is_curved:
        return window
    reachable_regions = find_reachable_surfaces(window, count)
    is_unreached = ~reachable_regions.any(axis=2)  # the program reports what is out of reach
    reachable_regions[is_unreached] = np.broadcast_to(terrain.allowed, reachable_regions.shape)[
        is_unreached
    ]
    return replace(window, by_round=reachable_regions)


def _find_stance_radius(scene: ClimbScene) -> float:
    """Find the largest distance of a toe from its nominal stance at the scene's start [m]."""
    start = scene.start
    nominal = start.com + scene.robot.stance_body @ rotation_world_body(start.rpy).T
    return float(np.linalg.norm(start.toes - nominal, axis=1).max())


def _build_approaching_window(
    scene: ClimbScene, path: BodyPath, target: float, count: int
) -> ClimbScene:
    """Build a window that approaches a point of the path and need not reach it."""
    window = _build_window(scene, count)
    fraction = target / path.length if path.length > 0 else 1.0
    com = path.interpolate(target)
    first, last = np.array(scene.spec.task.start.rpy_deg), np.array(scene.spec.task.goal.rpy_deg)
    rpy = np.deg2rad(first + fraction * (last - first))
    goal = _place_toes(window, com, rpy)
    spec = window.spec
    solver = spec.solver.model_copy(update={"gap": max(spec.solver.gap, LOOSE_GAP)})
    free_goal = spec.task.goal.model_copy(
        update={"tolerance": _FREE_TOLERANCE, "rotation_tolerance_deg": 360.0}
    )
    weights = spec.posture.weights
    weights = weights.model_copy(
        update={
            "goal": _GOAL_WEIGHT_FACTOR * weights.goal,
            "goal_rotation": _GOAL_WEIGHT_FACTOR * weights.goal_rotation,
            "goal_com": max(weights.goal_com, weights.goal),
        }
    )
    task = spec.task.model_copy(update={"goal": free_goal})
    posture = spec.posture.model_copy(update={"weights": weights})
    approaching = spec.model_copy(update={"task": task, "posture": posture, "solver": solver})
    return replace(window, spec=approaching, goal=goal)


def _place_toes(scene: ClimbScene, com: Array, rpy: Array) -> ClimbStance:
    """Place toes on the surface points nearest to the nominal stance of a body pose."""
    nominal = com + scene.robot.stance_body @ rotation_world_body(rpy).T
    region = np.array(
        [scene.terrain.nearest_surface(i, point) for i, point in enumerate(nominal)], np.int64
    )
    toes = [scene.terrain.surfaces[r].project(p) for r, p in zip(region, nominal, strict=True)]
    return ClimbStance(com, rpy, np.array(toes), region)
