"""Whether any toes could hold a body at a place: forces and moments of all surfaces within reach.

A toe at a point p of a flat convex region that presses with a force f in its friction cone exerts
the wrench (f, p x f), which is a sum of wrenches at the region's corners with forces in the same
cone. So whatever limbs stand wherever, what they exert together is a sum over corners of regions,
and whether the load can be balanced is one linear program with pyramids about the cones. Where it
cannot, the least sum of pulls towards the surfaces that could is told: what grippers would have to
hold. Torques and the number of limbs are not asked about: what is impossible here is impossible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.postures.outer import SLACK, longest_reach
from climbplan.climb.scene.climb_scene import MotionScene, load_wrench
from climbplan.schema.stated import stated
from climbplan.terrain.surfaces import Region

EDGES = 64  # of the pyramid about a friction cone
_FEWER = 16  # about each of many corners
_NONE = 1e-3  # of the load, a pull that means nothing


@dataclass(frozen=True)
class Unheld:
    """A place of the body at which nothing within reach carries it."""

    where: str  # "goal posture"
    pull: float  # [N] least sum of pulls towards surfaces that would do; infinite: none does
    regions: int  # within reach

    def __str__(self) -> str:
        reached = f"{self.regions} contact region{'s' if self.regions != 1 else ''} within reach"
        if not np.isfinite(self.pull):
            return f"no forces of toes on the {reached} carry the robot, pulling or pressing"
        return (
            f"toes that press on the {reached} cannot carry the robot, wherever they stand: a pull "
            f"of {self.pull:.0f} N towards surfaces is missing at least"
        )


def unheld(scene: MotionScene) -> list[Unheld]:
    """Start and goal, however the goal may be missed, where nothing within reach holds the body.

    Empty for grippers, which pull, for curved surfaces, and for limbs with masses or a payload
    beside the body's origin, whose moment depends on the posture. A safety factor counts only if
    the spec states it.
    """
    payload = scene.spec.task.payload
    aside = scene.robot.links is not None or (payload.mass > 0 and any(payload.offset))
    reach = longest_reach(scene)
    if scene.grippers is not None or scene.terrain.curved or aside or not np.isfinite(reach).all():
        return []
    load = load_wrench(scene.spec, scene.robot, np.zeros(3))
    load[2] -= scene.robot.weight
    force = float(np.linalg.norm(load[:3]))
    if not force:
        return []
    far = reach + np.linalg.norm(scene.robot.shoulder_body, axis=1)
    room = scene.spec.task.goal.tolerance
    found = []
    for where, com, missed in (
        ("start posture", scene.start.com, 0.0),
        ("goal posture", scene.goal.com, room),
    ):
        regions = _within(scene, com, far + missed)
        pull = force * _least_pull(scene, regions, com, missed, load / force)
        if pull > _NONE * force:
            found.append(Unheld(where, pull, len(regions)))
    return found


def _within(scene: MotionScene, com: Array, far: Array) -> list[tuple[Region, Array]]:
    """Regions that some limb could reach, and corners (K, 3) of what of them is near enough."""
    terrain, most = scene.terrain, float(far.max())
    found = []
    for number, region in enumerate(terrain.surfaces):
        limbs = terrain.allowed[:, number]
        if not isinstance(region, Region) or not limbs.any():
            continue
        if region.distance(com) <= float(far[limbs].max()) + SLACK:
            corners = _clipped(region.vertices, com, most + SLACK)
            if len(corners):
                found.append((region, corners))
    return found


def _clipped(corners: Array, middle: Array, most: float) -> Array:
    """Corners (K, 3) of a convex polygon within a box of that half size [m] about a point."""
    for axis in range(3):
        for sign in (1.0, -1.0):
            over = sign * (corners[:, axis] - middle[axis]) - most
            kept = []
            for k in range(len(corners)):
                a, b, before, after = corners[k - 1], corners[k], over[k - 1], over[k]
                if (before > 0) != (after > 0):
                    kept.append(a + before / (before - after) * (b - a))
                if after <= 0:
                    kept.append(b)
            corners = np.array(kept).reshape(-1, 3)
    return corners


def _least_pull(
    scene: MotionScene,
    regions: list[tuple[Region, Array]],
    com: Array,
    room: float,
    load: Array,
) -> float:
    """Least sum of pulls that balances a load (6,) about a body within `room` [m] of a place."""
    from climbplan.solvers.highs.linear import LinearProgram, solve_linear

    safety = 1.0
    if stated(scene.spec, "force.safety_friction"):
        safety = scene.spec.force.safety_friction
    wrenches, pulls = [np.zeros((0, 6))], [np.zeros((0, 6))]
    for region, corners in regions:
        edges = pyramid(region, region.friction / safety, _FEWER)
        # Feet of finite size touch behind where their centres are
        for corner in corners - region.standoff * region.normal - com:
            wrenches.append(np.hstack([edges, np.cross(corner, edges)]))
            pulls.append(np.concatenate([-region.normal, np.cross(corner, -region.normal)])[None])
    pressed, pulled = np.concatenate(wrenches), np.concatenate(pulls)
    # A body moved by d has its load's moment moved by d x F
    moved = np.hstack([np.zeros((3, 3)), np.cross(np.eye(3), load[:3])])
    columns = np.concatenate([pressed, pulled, moved])
    free = np.concatenate([np.full(len(pressed) + len(pulled), np.inf), np.full(3, room)])
    program = LinearProgram(
        np.concatenate([np.zeros(len(pressed)), np.ones(len(pulled)), np.zeros(3)]),
        np.concatenate([np.zeros(len(pressed) + len(pulled)), np.full(3, -room)]),
        free,
        sparse.csr_matrix(columns.T),
        -load - SLACK,
        -load + SLACK,
    )
    x = solve_linear(program).x
    if x is None:
        return float("inf")
    return float(x[len(pressed) : len(pressed) + len(pulled)].sum())


def pyramid(region: Region, friction: float, edges: int = EDGES) -> Array:
    """Edges (E, 3) of a pyramid that contains the friction cone of a region."""
    normal = region.normal
    across = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(normal, across)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = 2 * np.pi * np.arange(edges) / edges
    wide = friction / np.cos(np.pi / edges)
    turned = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return np.asarray(normal + wide * turned)
