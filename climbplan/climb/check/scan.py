"""Checks of a plan against the raw surface of its scan, which the file carries.

Contact regions result from planning and are not used here. Toes are measured against the triangles,
forces against the triangles' normals, links and body against all of them. The required clearances
are stated in `climbplan/terrain/raw_surface.py`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.check.anew.gait import reconstruct_gait
from climbplan.climb.check.anew.kinematics import compute_body_axes, transform_to_world
from climbplan.climb.check.convex import bound_hull_distance
from climbplan.climb.check.raw_distances import (
    measure_plane_gaps,
    measure_triangle_distances,
)
from climbplan.climb.check.scan_grips import check_gripped_sides
from climbplan.climb.check.scan_links import REPORTED_CLEARANCE, build_contacts, judge_scan_links
from climbplan.climb.check.subject import Subject
from climbplan.terrain.model import STATED
from climbplan.terrain.raw_surface import FACING, RawSurface
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, judge_worst


def check_scan(subject: Subject, scan: RawSurface) -> Iterator[Check]:
    """Yield checks of toes, friction and body against the raw surface, and of links at the
    instants.
    """
    yield _check_toes(subject, scan)
    yield _check_friction(subject, scan)
    yield from check_gripped_sides(subject)
    yield _check_body(subject, scan)
    foothold_round = reconstruct_gait(subject.plan).foothold_round
    contacts = build_contacts(subject, foothold_round, np.zeros_like(foothold_round) - 1)
    yield judge_scan_links(
        "scan.limbs", subject, subject.capsules, contacts, subject.describe_instant
    )


def _find_standing_toes(subject: Subject) -> tuple[IntArray, IntArray, Array]:
    """Return instants, limbs (S,) and positions (S, 3) of toes that stand on the scan."""
    plan = subject.plan
    is_scanned = np.array(
        [isinstance(s, Region) and s.name not in STATED for s in plan.terrain.surfaces], bool
    )
    standoff = np.array([getattr(s, "standoff", 0.0) for s in plan.terrain.surfaces])
    region = plan.instants.region
    instant, limb = np.nonzero(plan.instants.contact & is_scanned[region])
    toes = plan.instants.toes - standoff[region][..., None] * plan.instants.normal
    return np.asarray(instant, np.int64), np.asarray(limb, np.int64), toes[instant, limb]


def _check_toes(subject: Subject, scan: RawSurface) -> Check:
    """Check that every standing toe is within the flatness of the raw surface.

    A spherical foot, whose centre is the toe, also penetrates no other triangle deeper than that.
    """
    instant, limb, toes = _find_standing_toes(subject)
    if not len(toes):
        return judge_worst("scan.toes", np.zeros(1), lambda _: "", margin="no toe on the scan")
    foot = subject.plan.robot.foot
    radius = foot.radius if foot is not None else 0.0
    distance = _measure_unique(toes, scan, scan.flatness + 0.1)
    centres = subject.plan.instants.toes[instant, limb]
    depth = radius - _measure_unique(centres, scan, radius + scan.flatness)
    distance = np.maximum(distance, depth)

    def describe_place(row: int) -> str:
        return f"{subject.describe_instant(int(instant[row]))}, {subject.name_limb(int(limb[row]))}"

    margin = f"{1e3 * distance.max():.2f} mm off, asked {1e3 * scan.flatness:.2f} mm"
    return judge_worst(
        "scan.toes", distance - scan.flatness, describe_place, margin, distance / scan.flatness
    )


def _measure_unique(points: Array, scan: RawSurface, limit: float) -> Array:
    """Return distances (S,) of points (S, 3) from the raw surface, at most a limit [m].

    Most points occur several times, and each place is measured once.
    """
    unique, inverse = np.unique(points, axis=0, return_inverse=True)
    distance = measure_triangle_distances(unique, unique, scan.corners, limit)
    return distance[inverse.reshape(-1)]


def _check_friction(subject: Subject, scan: RawSurface) -> Check:
    """Check that forces are within the friction cone of the raw surface's normal about each toe."""
    plan = subject.plan
    instant, limb, toes = _find_standing_toes(subject)
    if not len(toes) or plan.robot.gripper is not None:
        margin = "held by grippers" if len(toes) else "no toe on the scan"
        return judge_worst("scan.friction", np.zeros(1), lambda _: "", margin=margin)
    planned = plan.instants.normal[instant, limb]
    unique_contacts, inverse = np.unique(np.hstack([toes, planned]), axis=0, return_inverse=True)
    normals = _average_normals(unique_contacts[:, :3], unique_contacts[:, 3:], scan)[
        inverse.reshape(-1)
    ]
    force, mu = plan.forces.force[instant, limb], plan.instants.mu[instant, limb]
    normal_force = (force * normals).sum(axis=1)
    tangential_force = np.linalg.norm(force - normal_force[:, None] * normals, axis=1)
    cone_violation = (tangential_force - mu * normal_force) / subject.weight
    normal_deviation = np.arccos(np.clip((normals * planned).sum(axis=1), -1, 1))

    def describe_place(row: int) -> str:
        return f"{subject.describe_instant(int(instant[row]))}, {subject.name_limb(int(limb[row]))}"

    friction_ratio = tangential_force / np.maximum(mu * normal_force, 1e-9 * subject.weight)
    is_loaded = np.linalg.norm(force, axis=1) > 1e-6 * subject.weight
    friction_ratio = np.where(is_loaded, friction_ratio, 0.0)
    margin = (
        f"S_mu {1 / max(float(friction_ratio.max()), 1e-9):.2f}, "
        f"raw normals off by up to {np.rad2deg(normal_deviation.max()):.1f} deg"
    )
    return judge_worst("scan.friction", cone_violation, describe_place, margin, friction_ratio)


def _average_normals(toes: Array, planned: Array, scan: RawSurface) -> Array:
    """Return mean normals (S, 3) of raw triangles about each toe that face as its region does."""
    corners = scan.corners
    normal_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal_vectors, axis=1)
    normals = normal_vectors / np.maximum(size, 1e-15)[:, None]
    search_radius = scan.toe_radius + scan.flatness
    disc = np.pi * search_radius**2
    mean_normals = np.array(planned)
    for row, (toe, normal) in enumerate(zip(toes, planned, strict=True)):
        candidates = scan.find_triangles_in(toe - search_radius, toe + search_radius)
        candidates = candidates[normals[candidates] @ normal > FACING]
        ends = np.broadcast_to(toe, (len(candidates), 3))
        candidates = candidates[
            measure_plane_gaps(ends, ends, corners[candidates]) <= search_radius
        ]
        if len(candidates):
            mean = np.minimum(size[candidates] / 2, disc) @ normals[candidates]
            mean_normals[row] = mean / np.linalg.norm(mean)
    return mean_normals


def _check_body(subject: Subject, scan: RawSurface) -> Check:
    """Check that the hull keeps its clearance from all triangles at every instant and sample."""
    plan = subject.plan
    required = plan.limits.body_clearance
    poses = np.vstack(
        [
            np.hstack([plan.instants.com, plan.instants.rpy]),
            np.hstack([plan.trajectory.com, plan.trajectory.rpy]),
        ]
    )
    is_new_pose = np.append(True, (np.diff(poses, axis=0) != 0).any(axis=1))
    rows = np.flatnonzero(is_new_pose)
    hulls = transform_to_world(
        poses[rows, :3], compute_body_axes(poses[rows, 3:]), subject.body.corners
    )
    corners, measured_clearance = scan.corners, required + REPORTED_CLEARANCE
    clearance = np.full(len(rows), measured_clearance)
    for p, hull in enumerate(hulls):
        for t in scan.find_triangles_in(
            hull.min(axis=0) - measured_clearance, hull.max(axis=0) + measured_clearance
        ):
            clearance[p] = min(clearance[p], bound_hull_distance(hull, corners[t]))

    def describe_place(pose: int) -> str:
        row, count = int(rows[pose]), plan.instants.count
        return subject.describe_instant(row) if row < count else subject.describe_time(row - count)

    min_clearance = float(clearance.min())
    qualifier = "at least " if min_clearance >= measured_clearance else ""
    margin = f"{qualifier}{1e3 * min_clearance:.1f} mm, asked {1e3 * required:.1f} mm"
    return judge_worst(
        "scan.body",
        required - clearance,
        describe_place,
        margin,
        required / np.maximum(clearance, 1e-9),
    )
