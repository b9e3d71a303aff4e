"""What climbs with flat feet cannot be, told at the keys of the spec."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.schema.model import CONVEX_METHODS, ClimbSpec
from climbplan.errors import SpecMistake
from climbplan.robots.model import Robot
from climbplan.terrain.model import Terrain
from climbplan.terrain.soles import beyond, fits

_OVER = 1e-6  # [m] beyond an edge that counts as none


def flat_foot_mistakes(spec: ClimbSpec, robot: Robot, terrain: Terrain) -> Iterator[SpecMistake]:
    """What the spec and its terrain cannot have of a robot with flat feet; nothing for others."""
    sole = robot.sole
    if sole is None:
        return
    what = "flat feet are planned with"
    if terrain.curved:
        yield SpecMistake("terrain.tube", f"{what} flat surfaces alone")
    if spec.terrain.scan is not None:
        yield SpecMistake("terrain.scan", f"{what} stated surfaces alone, not scans")
    if spec.force.sag != "compensated":
        yield SpecMistake("force.sag", f"{what} `compensated`: a body that sags would tilt them")
    if spec.solver.method not in ("auto", *CONVEX_METHODS):
        known = ", ".join(f"`{name}`" for name in CONVEX_METHODS)
        yield SpecMistake("solver.method", f"{what} the methods `auto`, {known} alone")
    if terrain.curved:
        return
    room = np.array([fits(region, sole) for region in terrain.regions])
    for limb in np.flatnonzero(~(terrain.allowed & room).any(axis=1)):
        size = f"{1e3 * sole.length:.0f} x {1e3 * sole.width:.0f} mm"
        name = robot.limb_names[limb]
        yield SpecMistake("terrain", f"no surface that {name} may use has room for its {size} sole")


def overhanging(
    key: str, robot: Robot, terrain: Terrain, toes: Array, region: IntArray
) -> Iterator[SpecMistake]:
    """Soles about toes (N, 3) that reach beyond their surfaces (N,)."""
    if robot.sole is None or terrain.curved:
        return
    for limb, name in enumerate(robot.limb_names):
        surface = terrain.regions[region[limb]]
        over = beyond(surface, robot.sole, toes[limb])
        if over > _OVER:
            yield SpecMistake(
                f"{key}.toes.{name}",
                f"expected the whole sole of {name} on {surface.name!r}; it reaches "
                f"{1e3 * over:.1f} mm beyond its edge",
            )
