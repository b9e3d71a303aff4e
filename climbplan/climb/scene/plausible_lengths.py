"""Lengths and loads that the robot's own size and motors mark as mistaken units."""

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

    So are a load that the motors could not hold by far, and a pace of robots with grippers.

    Args:
        spec: Spec of a climb or a transition.
        robot: The robot as it is planned with.
        terrain: Terrain with all surfaces of the spec.
    """
    yield from _find_implausible_payload(spec, robot)
    if spec.trajectory.pace is not None and robot.gripper is not None:
        yield SpecMistake(
            "trajectory.pace",
            f"expected none: {robot.name} has grippers, whose holds are planned for quasi-static "
            "motions",
        )
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


def _find_implausible_payload(spec: MotionSpec, robot: Robot) -> Iterator[SpecMistake]:
    """Yield a mistake for a payload whose weight is out of all proportion to the torque limits.

    A limb with its strongest joint at the lever of its whole reach holds max_torque / reach. Bent
    limbs and braced ones hold more, by less than `_MAX_RATIO`.
    """
    levers = np.where(robot.slides, 1.0, robot.reach)  # [m]; joints that slide have forces
    force = float((robot.max_torque / levers).max(axis=1).sum())  # [N] of all limbs
    payload = spec.task.payload.mass
    weight = robot.gravity * (robot.mass + payload)
    if payload > 0 and np.isfinite(force) and weight > _MAX_RATIO * force:
        yield SpecMistake(
            "task.payload.mass",
            f"expected a payload that the motors of {robot.name} hold (their torque limits carry "
            f"{force / robot.gravity:.3g} kg on stretched limbs, its own {robot.mass:.3g} kg "
            f"included), got {payload:.6g} kg, {weight / force:.0f} times that; masses are in "
            f"kilograms, {payload:.6g} g are {1e-3 * payload:.4g}",
        )


def _build_mistake(key: str, what: str, length: float, robot: Robot, span: float) -> SpecMistake:
    """Return the mistake of a length that is far larger than what the robot spans."""
    return SpecMistake(
        key,
        f"expected {what} that {robot.name} spans ({span:.3g} m at most), got {length:.6g} m, "
        f"{length / span:.0f} times that; lengths are in metres, {length:.6g} mm are "
        f"{1e-3 * length:.4g}",
    )
