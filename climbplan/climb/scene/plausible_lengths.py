"""Lengths of a scene that the robot's own size marks as mistaken units."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.climb.schema.motion import MotionSpec
from climbplan.errors import SpecMistake
from climbplan.robots.model import Robot
from climbplan.terrain.model import Terrain

_MAX_RATIO = 20.0  # of a length to what the robot spans; centimetres for metres are 100 times


def find_implausible_lengths(
    spec: MotionSpec, robot: Robot, terrain: Terrain
) -> Iterator[SpecMistake]:
    """Yield a mistake for each length that is out of all proportion to the robot.

    These are walls and tubes far wider than limbs brace, and a start or goal far from every
    surface.

    Args:
        spec: Spec of a climb or a transition.
        robot: The robot as it is planned with.
        terrain: Terrain with all surfaces of the spec.
    """
    hips = float(np.linalg.norm(robot.shoulder_body, axis=1).max())
    radius = robot.reach + hips  # [m] from the body's origin to the farthest toe
    walls, tube = spec.terrain.walls, spec.terrain.tube
    if walls is not None and walls.gap > _MAX_RATIO * 2 * radius:
        yield _build_mistake("terrain.walls.gap", "a gap", walls.gap, robot, 2 * radius)
    elif tube is not None and tube.radius > _MAX_RATIO * radius:
        yield _build_mistake("terrain.tube.radius", "a radius", tube.radius, robot, radius)
    else:
        yield from _find_distant_postures(spec, robot, terrain, radius)


def _find_distant_postures(
    spec: MotionSpec, robot: Robot, terrain: Terrain, radius: float
) -> Iterator[SpecMistake]:
    """Yield a mistake for start and goal far from every surface."""
    if not terrain.surfaces:
        return
    for key in ("start", "goal"):
        com = np.array(getattr(spec.task, key).com, float)
        distance = min(float(surface.distance(com)) for surface in terrain.surfaces)
        if distance > _MAX_RATIO * radius:
            what = "a distance from the nearest contact surface"
            yield _build_mistake(f"task.{key}.com", what, distance, robot, radius)


def _build_mistake(key: str, what: str, length: float, robot: Robot, span: float) -> SpecMistake:
    """Return the mistake of a length that is far larger than what the robot spans."""
    return SpecMistake(
        key,
        f"expected {what} that {robot.name} spans ({span:.3g} m at most), got {length:.6g} m, "
        f"{length / span:.0f} times that; lengths are in metres, {length:.6g} mm are "
        f"{1e-3 * length:.4g}",
    )
