"""Static feasibility of a body position: can any toes within reach balance the load?

A toe at a point p of a flat convex region that presses with a force f in its friction cone exerts
the wrench (f, p x f). That wrench is a sum of wrenches at the region's corners, with forces in the
same cone. So the wrenches of any limbs at any toes are contained in the sum of the corners' wrench
cones (contact wrench cone). Whether the load can be balanced is one linear program with pyramids
about the cones. Where it cannot, the program gives the smallest sum of pulls towards the surfaces
that would be needed, which is what grippers would have to hold. Torques and the number of limbs are
left out: the program is a relaxation, so that its infeasibility is a proof.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.postures.outer_relaxation import SLACK, compute_max_reach
from climbplan.climb.scene.climb_scene import MotionScene, compute_load_wrench
from climbplan.schema.stated import is_stated
from climbplan.terrain.surfaces import Region

NUM_EDGES = 64  # of the pyramid about a friction cone
_NUM_EDGES_PER_CORNER = 16  # about each of many corners
_PULL_TOLERANCE = 1e-3  # of the load, a pull that means nothing


@dataclass(frozen=True)
class UnsupportedPlace:
    """A place of the body at which no contacts within reach can balance the load."""

    place: str  # "goal posture"
    min_pull: float  # [N] least sum of pulls towards surfaces that would do; infinite: none does
    num_regions: int  # within reach

    def __str__(self) -> str:
        reached = (
            f"{self.num_regions} contact region{'s' if self.num_regions != 1 else ''} within reach"
        )
        if not np.isfinite(self.min_pull):
            return f"no forces of toes on the {reached} carry the robot, pulling or pressing"
        return (
            f"toes that press on the {reached} cannot carry the robot, wherever they stand: a pull "
            f"of {self.min_pull:.0f} N towards surfaces is missing at least"
        )


def find_unsupported_places(scene: MotionScene) -> list[UnsupportedPlace]:
    """Return which of start and goal no contacts within reach can support, for any allowed goal
    error.

    Safety factors count only if the spec states them.

    Returns:
        An empty list also where the test does not apply: for grippers, which pull; for curved
        surfaces; and for link masses or a payload away from the body's origin, whose moment depends
            on
        the posture.
    """
    payload = scene.spec.task.payload
    has_offset_mass = scene.robot.links is not None or (payload.mass > 0 and any(payload.offset))
    reach = compute_max_reach(scene)
    if (
        scene.grippers is not None
        or scene.terrain.is_curved
        or has_offset_mass
        or not np.isfinite(reach).all()
    ):
        return []
    load = compute_load_wrench(scene.spec, scene.robot, np.zeros(3))
    load[2] -= scene.robot.weight
    force = float(np.linalg.norm(load[:3]))
    if not force:
        return []
    max_distance = reach + np.linalg.norm(scene.robot.shoulder_body, axis=1)
    goal_tolerance = scene.spec.task.goal.tolerance
    unsupported = []
    for place, com, tolerance in (
        ("start posture", scene.start.com, 0.0),
        ("goal posture", scene.goal.com, goal_tolerance),
    ):
        regions = _find_reachable_regions(scene, com, max_distance + tolerance)
        pull = force * _minimise_pull(scene, regions, com, tolerance, load / force)
        if pull > _PULL_TOLERANCE * force:
            unsupported.append(UnsupportedPlace(place, pull, len(regions)))
    return unsupported


def _find_reachable_regions(
    scene: MotionScene, com: Array, max_distance: Array
) -> list[tuple[Region, Array]]:
    """Return the regions that some limb could reach, with the corners (K, 3) of their reachable
    part.
    """
    terrain, half_size = scene.terrain, float(max_distance.max())
    reachable = []
    for index, region in enumerate(terrain.surfaces):
        limbs = terrain.allowed[:, index]
        if not isinstance(region, Region) or not limbs.any():
            continue
        if region.distance(com) <= float(max_distance[limbs].max()) + SLACK:
            corners = _clip_to_box(region.vertices, com, half_size + SLACK)
            if len(corners):
                reachable.append((region, corners))
    return reachable


def _clip_to_box(corners: Array, centre: Array, half_size: float) -> Array:
    """Return the corners (K, 3) of a convex polygon clipped to an axis-aligned cube about a point.

    The algorithm is that of Sutherland and Hodgman; half_size is half the cube's edge [m].
    """
    for axis in range(3):
        for sign in (1.0, -1.0):
            excess = sign * (corners[:, axis] - centre[axis]) - half_size
            clipped = []
            for k in range(len(corners)):
                a, b, excess_a, excess_b = corners[k - 1], corners[k], excess[k - 1], excess[k]
                if (excess_a > 0) != (excess_b > 0):
                    clipped.append(a + excess_a / (excess_a - excess_b) * (b - a))
                if excess_b <= 0:
                    clipped.append(b)
            corners = np.array(clipped).reshape(-1, 3)
    return corners


def _minimise_pull(
    scene: MotionScene,
    regions: list[tuple[Region, Array]],
    com: Array,
    tolerance: float,
    load: Array,
) -> float:
    """Return the smallest sum of pulls that balances a load (6,) about a body near a place.

    The body may be up to `tolerance` [m] away from `com` along each axis. Infinite where no pull
    suffices.
    """
    from climbplan.solvers.highs.linear import LinearProgram, solve_linear

    safety = 1.0
    if is_stated(scene.spec, "force.safety_friction"):
        safety = scene.spec.force.safety_friction
    wrenches, pulls = [np.zeros((0, 6))], [np.zeros((0, 6))]
    for region, corners in regions:
        edges = build_pyramid_edges(region, region.friction / safety, _NUM_EDGES_PER_CORNER)
        # Feet of finite size touch behind where their centres are
        for corner in corners - region.standoff * region.normal - com:
            wrenches.append(np.hstack([edges, np.cross(corner, edges)]))
            pulls.append(np.concatenate([-region.normal, np.cross(corner, -region.normal)])[None])
    push_wrenches, pull_wrenches = np.concatenate(wrenches), np.concatenate(pulls)
    # A body moved by d has its load's moment moved by d x F
    shift_wrenches = np.hstack([np.zeros((3, 3)), np.cross(np.eye(3), load[:3])])
    columns = np.concatenate([push_wrenches, pull_wrenches, shift_wrenches])
    upper = np.concatenate(
        [np.full(len(push_wrenches) + len(pull_wrenches), np.inf), np.full(3, tolerance)]
    )
    program = LinearProgram(
        np.concatenate([np.zeros(len(push_wrenches)), np.ones(len(pull_wrenches)), np.zeros(3)]),
        np.concatenate([np.zeros(len(push_wrenches) + len(pull_wrenches)), np.full(3, -tolerance)]),
        upper,
        sparse.csr_matrix(columns.T),
        -load - SLACK,
        -load + SLACK,
    )
    x = solve_linear(program).x
    if x is None:
        return float("inf")
    return float(x[len(push_wrenches) : len(push_wrenches) + len(pull_wrenches)].sum())


def build_pyramid_edges(region: Region, friction: float, edges: int = NUM_EDGES) -> Array:
    """Return the edges (E, 3) of a pyramid that contains the friction cone of a region."""
    normal = region.normal
    reference = np.eye(3)[int(np.argmin(np.abs(normal)))]
    tangent_1 = np.cross(normal, reference)
    tangent_1 /= np.linalg.norm(tangent_1)
    tangent_2 = np.cross(normal, tangent_1)
    angle = 2 * np.pi * np.arange(edges) / edges
    half_width = friction / np.cos(np.pi / edges)
    directions = np.cos(angle)[:, None] * tangent_1 + np.sin(angle)[:, None] * tangent_2
    return np.asarray(normal + half_width * directions)
