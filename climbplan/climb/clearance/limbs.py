"""Room between links and solids: standing limbs along the whole motion, exact kinematics.

Links keep their radius from obstacles, from the material behind surfaces and from the walls of
tubes. Near what its limb may stand on, a last link keeps less: a point of its axis at distance d
from the toe keeps

    min(r, f + d / 4),

in steps along the link, where r is the radius of the link and f that of a spherical foot, so that
a limb is a cone of 14 degrees there. Without such a foot, the last 5 cm are left out. The checks
measure it again (`climbplan/climb/check/clearance.py`); scans have a rule of their own
(`climbplan/terrain/raw_surface.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.clearance.raw_surface import THE_SCAN, ToeContacts, find_nearest_raw
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import ClimbScene, MotionScene
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.kinematics import (
    joint_points_body,
    solve_inverse_kinematics,
    standing_inverse,
    to_body,
)
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.raw_surface import NARROW, SLENDER
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Tube

INTERPOLATION_MARGIN = (
    1e-3  # [m] that links, as thick as they are, keep: what one may lose between checked poses
)
_NUM_POSES = 6  # poses checked along a push
_NUM_TAPER_PIECES = 6  # pieces of a last link, each as thick as at its thinner end
_SAME_SPHERE = 1e-3  # [m] by which the capsule of a foot may reach beyond its sphere
_ON_SOLID = 1e-3  # [m] within which a toe stands on a solid
_TOUCHING = 1e-9  # [m] a corner this close to a face belongs to it


def compute_standing_clearance(scene: ClimbScene) -> float:
    """Distance [m] of links' axes that postures are planned with, with the spec's clearance."""
    return scene.robot.limb_radius + max(scene.spec.posture.limb_clearance, INTERPOLATION_MARGIN)


@dataclass(frozen=True)
class LimbShortfall:
    """The link that comes closest to an obstacle."""

    missing: float  # [m] of the room asked for, <= 0 if it is kept
    where: str  # "round 3, LM lifted"
    limb: int
    link: int
    radius: float  # [m]
    obstacle: str
    solids: tuple[Solid, ...] = ()  # that links come too close to
    toe: Array | None = None  # (3,) of that limb where it stands on another surface [m]

    def describe(self, scene: MotionScene) -> str:
        """Limb, link, obstacle and missing room in the robot's terms."""
        robot = scene.robot
        name = f"{robot.limb_names[self.limb]}'s {robot.joint_name(self.limb, self.link)}"
        return (
            f"{name}, {1e3 * self.radius:.0f} mm in radius, comes {1e3 * self.missing:.1f} mm too "
            f"close to {self.obstacle!r}"
        )


def find_limb_shortfall(
    scene: MotionScene, rounds: Rounds, instants: Instants
) -> LimbShortfall | None:
    """Return where standing limbs come closest to a solid or a scan; None if there is neither.

    Looked at along every push, from the placing of a limb to the next lift, and at the start.
    """
    if not scene.terrain.link_solids and scene.terrain.scan is None:
        return None
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    fractions = np.linspace(0.0, 1.0, _NUM_POSES)[:, None]
    com, rpy = (
        x[lift, None] + fractions * (x[push] - x[lift])[:, None]
        for x in (instants.com, instants.rpy)
    )  # (P, S, 3)
    toes = np.broadcast_to(instants.toes[push, None], (*com.shape[:2], scene.robot.limb_count, 3))
    normals = np.broadcast_to(instants.normal[push, None], toes.shape)
    # At the start all stand where the first instant has them, or left from there
    first = instants.normal[:1]
    start = instants.com[:1], instants.rpy[:1], rounds.toes[:1], first
    flat_toes, flat_normals = (v.reshape(-1, *v.shape[2:]) for v in (toes, normals))
    flat = (com.reshape(-1, 3), rpy.reshape(-1, 3), flat_toes, flat_normals)
    stood = np.concatenate([start[2], flat_toes])
    links = compute_world_capsules(
        scene, *(np.concatenate(both) for both in zip(start, flat, strict=True))
    )
    solids = scene.terrain.link_solids

    def shortfall(
        missing: float, index: tuple[int, ...], link: int, radius: float, name: str
    ) -> LimbShortfall:
        pose, limb = index
        where = "start posture"
        if pose > 0:
            where = instants.label(int(push[(pose - 1) // _NUM_POSES]), scene.robot.limb_names)
        return LimbShortfall(missing, where, limb, link, radius, name)

    short = []
    if solids:
        closest = find_closest_link(scene, links)
        solid = solids[closest.solid]
        missing = INTERPOLATION_MARGIN - closest.distance
        nearest = shortfall(missing, closest.index, closest.link, closest.radius, solid.name)
        if isinstance(solid, Solid):
            pose, limb = closest.index
            toe = stood[pose, limb]
            # One that it stands on is as near to its toe as feet are large
            on_it = solid.face_distance(toe) < scene.robot.standoff + _ON_SOLID
            toe = None if on_it else toe
            nearest = replace(nearest, solids=(solid,), toe=toe)
        short.append(nearest)
    if scene.terrain.scan is not None:
        contacts = ToeContacts(
            np.concatenate([start[2], flat_toes])[..., None, :],
            np.concatenate([first, flat_normals])[..., None, :],
        )
        raw = find_nearest_raw(scene.terrain.scan, links, contacts, INTERPOLATION_MARGIN)
        nearest = shortfall(raw.missing, raw.index, raw.link, raw.radius, THE_SCAN)
        short.append(replace(nearest, solids=raw.solids))
    return max(short, key=lambda s: s.missing)


def compute_limb_points(scene: MotionScene, com: Array, rpy: Array, toes: Array) -> Array:
    """Joints and toes (P, N, J + 1, 3) of limbs for toes (P, N, 3), world; NaN out of reach.

    Of feet that are not flat.
    """
    robot = scene.robot
    angles = solve_inverse_kinematics(robot, to_body(com, rpy, toes)).best()
    points = joint_points_body(robot, angles)
    return com[:, None, None] + np.einsum("kab,knjb->knja", rotation_world_body(rpy), points)


def compute_world_capsules(
    scene: MotionScene, com: Array, rpy: Array, toes: Array, normal: Array
) -> Capsules:
    """Links (P, N, C) of limbs for toes (P, N, 3), world; NaN out of reach.

    normal: (P, N, 3) of the surfaces under the toes.
    """
    angles = standing_inverse(scene.robot, com, rpy, toes, normal).best()
    return limb_capsules(scene.robot, angles).to_world(com, rotation_world_body(rpy))


def get_foot_radius(robot: Robot) -> float:
    """Return the radius of spherical feet [m]; zero for points, soles and grippers."""
    return 0.0 if robot.foot is None or robot.foot.sole is not None else robot.foot.radius


def taper_links(links: Capsules, foot: float) -> Capsules:
    """Return links as they keep off what they may stand on: last ones narrow to their toes.

    Args:
        links: (..., N, C) links.
        foot: Radius of spherical feet [m], else zero.

    Returns:
        (..., N, C + 6 C) links, whose radius is the room that they keep; NaN for what is left out.
    """
    last = np.isfinite(links.to_toe)  # (N, C)
    first = 0.0 if foot > 0 else NARROW
    taper_length = np.maximum(
        (links.radius + INTERPOLATION_MARGIN - foot) / SLENDER, first
    )  # (N, C) from the toe on
    along = links.starts - links.ends
    length = np.linalg.norm(along, axis=-1)  # (..., N, C)
    unit = along / np.maximum(length, 1e-9)[..., None]
    beyond = links.to_toe + np.nan_to_num(
        _find_largest_length(length)
    )  # (N, C) from the toe to the start
    foot_itself = last & (beyond + links.radius <= foot + _SAME_SPHERE)

    def interpolate_links(distances: Array) -> Array:
        """Interpolate points (..., N, C, 3) on last links at distances (N, C) from their toes."""
        distance = np.clip(distances - np.where(last, links.to_toe, 0.0), 0.0, length)
        return np.asarray(links.ends + distance[..., None] * unit)

    # From the knee on to where a link begins to narrow, then piece by piece to the toe
    is_left_out = last & (taper_length >= beyond)
    starts = [np.where((is_left_out | foot_itself)[..., None], np.nan, links.starts)]
    ends, radii = (
        [np.where(last[..., None], interpolate_links(taper_length), links.ends)],
        [links.radius],
    )
    for piece in range(_NUM_TAPER_PIECES):
        distances = (
            first
            + (taper_length - first)
            * np.array([piece + 1, piece])[:, None, None]
            / _NUM_TAPER_PIECES
        )
        left_out = ~last | foot_itself | (distances[0] <= links.to_toe) | (distances[1] >= beyond)
        left_out |= distances[0] <= distances[1]
        starts.append(np.where(left_out[..., None], np.nan, interpolate_links(distances[0])))
        ends.append(interpolate_links(distances[1]))
        radii.append(np.minimum(links.radius, foot + SLENDER * distances[1] - INTERPOLATION_MARGIN))
    return Capsules(
        np.concatenate(starts, axis=-2),
        np.concatenate(ends, axis=-2),
        np.concatenate(radii, axis=-1),
        np.tile(links.link, 1 + _NUM_TAPER_PIECES),
        np.tile(links.to_toe, 1 + _NUM_TAPER_PIECES),
    )


def _find_largest_length(length: Array) -> Array:
    """Find the length (N, C) of links (..., N, C), equal in all poses; zero if unknown."""
    flat = length.reshape(-1, *length.shape[-2:])
    return np.asarray(np.where(np.isnan(flat), 0.0, flat).max(axis=0, initial=0.0))


@dataclass(frozen=True)
class ClosestLink:
    """The link closest to a solid among many."""

    distance: float  # [m] of its surface
    index: tuple[int, ...]  # of pose and limb
    link: int
    radius: float  # [m]
    solid: int  # of `Terrain.link_solids`


def find_closest_link(scene: MotionScene, links: Capsules, limb: int | None = None) -> ClosestLink:
    """Return the link that comes closest to a solid, as thick as links are; NaN are left out.

    Args:
        scene: Robot and terrain, which has solids.
        links: (..., N, C) links in the world; of one limb alone where `limb` is given.
        limb: Number of that limb.

    Distances beyond `BETWEEN` are lower bounds.
    """
    distances = compute_link_clearances(scene, links, INTERPOLATION_MARGIN, limb)
    index_of_min = int(np.argmin(np.where(np.isnan(distances), np.inf, distances)))
    *index, solid, link = (int(i) for i in np.unravel_index(index_of_min, distances.shape))
    which = index[-1], link
    return ClosestLink(
        float(distances.flat[index_of_min]),
        tuple(index) if limb is None else (*index[:-1], limb),
        int(links.link[which]),
        float(links.radius[which]),
        solid,
    )


def compute_link_clearances(
    scene: MotionScene, links: Capsules, max_distance: float, limb: int | None = None
) -> Array:
    """Compute clearances (..., N, S, C) of links from each of `Terrain.link_solids` [m].

    Args:
        scene: Robot and terrain.
        links: (..., N, C) links in the world; of one limb alone where `limb` is given.
        enough: Room up to which it is measured [m]; beyond it values are lower bounds.
        limb: Number of that limb.

    NaN where links are; infinite for the sphere of a foot on what it may stand on.
    """
    terrain = scene.terrain
    count = links.radius.shape[-1]
    tapered = taper_links(links, get_foot_radius(scene.robot))
    stood = terrain.stood_solids if limb is None else terrain.stood_solids[limb : limb + 1]
    clearances = np.empty((*links.starts.shape[:-2], len(terrain.link_solids), count))
    for number, solid in enumerate(terrain.link_solids):
        is_stood_on = stood[:, number]
        for chosen, rows in (
            (links, np.flatnonzero(~is_stood_on)),
            (tapered, np.flatnonzero(is_stood_on)),
        ):
            if not len(rows):
                continue
            radius = chosen.radius[rows]
            starts, ends = (v[..., rows, :, :] for v in (chosen.starts, chosen.ends))
            distances = (
                compute_link_distances(solid, starts, ends, float(radius.max()) + max_distance)
                - radius
            )
            # All pieces of a link; what is left out has no places
            pieces = distances.reshape(*distances.shape[:-1], -1, count)
            distances = np.where(np.isnan(pieces), np.inf, pieces).min(axis=-2)
            clearances[..., rows, number, :] = distances
    unknown = np.asarray(np.isnan(links.starts).any(axis=-1))[..., None, :]
    return np.where(unknown, np.nan, clearances)


def compute_link_distances(
    solid: Solid | Tube, starts: Array, ends: Array, max_distance: float = np.inf
) -> Array:
    """Compute distances (...) of segments (..., 3) from a convex solid, negative inside it.

    From the wall of a tube the distance is that from inside.

    A segment that a face parts from the solid by `enough` [m] gets that lower bound instead. Where
    they meet, the value is minus the way out across a face.
    """
    if isinstance(solid, Tube):
        radial = np.linalg.norm(np.stack([starts, ends])[..., :2] - solid.center, axis=-1)
        return np.asarray(solid.wall - radial.max(axis=0))  # the inside is convex
    flat = np.stack([starts.reshape(-1, 3), ends.reshape(-1, 3)])
    faces = flat @ solid.A.T - solid.b  # (2, S, F)
    distance = faces.min(axis=0).max(axis=1)
    is_near = distance < max_distance
    if is_near.any():
        distance[is_near] = _compute_near_distances(
            solid, flat[:, is_near], faces[:, is_near], distance[is_near]
        )
    return np.asarray(distance.reshape(starts.shape[:-1]))


def _compute_near_distances(solid: Solid, flat: Array, faces: Array, bound: Array) -> Array:
    """Compute exact distances (S,) of segments (2, S, 3) with face distances (2, S, F) of ends.

    Apart, the nearest points lie on an edge of the solid or at an end of the segment before a face.
    """
    best = _compute_edge_distances(solid, *flat)
    for end, distance in zip(flat, faces, strict=True):
        foot = end[:, None] - distance[..., None] * solid.A  # (S, F, 3)
        on_face = (foot @ solid.A.T - solid.b).max(axis=-1) <= _TOUCHING
        best = np.minimum(best, np.where(on_face & (distance >= 0), distance, np.inf).min(axis=1))
    return np.where((bound < 0) & _is_intersecting(faces), bound, best)


def _is_intersecting(faces: Array) -> BoolArray:
    """Return whether segments (S,) with face distances (2, S, F) at their ends cross the solid."""
    first, last = faces
    slope = last - first
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -first / slope
    enter = np.where(slope < 0, crossing, -np.inf).max(axis=1)
    leave = np.where(slope > 0, crossing, np.inf).min(axis=1)
    is_outside = ((slope == 0) & (first > 0)).any(axis=1)
    return np.asarray(~is_outside & (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)))


def _compute_edge_distances(solid: Solid, starts: Array, ends: Array) -> Array:
    """Compute the smallest distance (S,) of segments from all edges of a solid [m]."""
    on = np.abs(solid.vertices @ solid.A.T - solid.b) < 1e3 * _TOUCHING
    first, last = np.nonzero(np.triu(on.astype(int) @ on.T.astype(int) >= 2, k=1))
    origin, edge = solid.vertices[first], solid.vertices[last] - solid.vertices[first]
    link, apart = (ends - starts)[:, None], starts[:, None] - origin
    # Least |apart + s link - t edge| over the unit square: s inside for the best t, and back
    a = np.maximum((link**2).sum(axis=-1), np.finfo(float).tiny)
    e = (edge**2).sum(axis=-1)
    b, c, f = (link * edge).sum(-1), (link * apart).sum(-1), (apart * edge).sum(-1)
    det = a * e - b * b
    s = np.clip(np.where(det > 1e-12 * a * e, b * f - c * e, 0.0) / np.maximum(det, 1e-300), 0, 1)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    gap = apart + s[..., None] * link - t[..., None] * edge
    return np.asarray(np.sqrt((gap**2).sum(axis=-1)).min(axis=1))
