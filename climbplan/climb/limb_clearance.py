"""Room between links and obstacles: standing limbs along the whole motion, exact kinematics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.plan.climb_plan import Instants, Mask, Rounds
from climbplan.climb.raw_clearance import THE_SCAN, Contacts, nearest_raw
from climbplan.climb.scene import ClimbScene, MotionScene
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.kinematics import (
    inverse,
    joint_points_body,
    standing_inverse,
    to_body,
)
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.terrain.solids import Solid

BETWEEN = (
    1e-3  # [m] that links, as thick as they are, keep: what one may lose between checked poses
)
NARROW = 0.05  # [m] last part of a limb, which narrows to its toe where it stands
_STEPS = 6  # poses checked along a push
_TOUCHING = 1e-9  # [m] a corner this close to a face belongs to it


def standing_room(scene: ClimbScene) -> float:
    """Distance [m] of links' axes that postures are planned with, with the spec's clearance."""
    return scene.robot.limb_radius + max(scene.spec.posture.limb_clearance, BETWEEN)


@dataclass(frozen=True)
class LimbShortfall:
    """The link that comes closest to an obstacle."""

    missing: float  # [m] of the room asked for, <= 0 if it is kept
    where: str  # "round 3, LM lifted"
    limb: int
    link: int
    radius: float  # [m]
    obstacle: str
    solids: tuple[Solid, ...] = ()  # of a scan, that links come too close to

    def words(self, scene: MotionScene) -> str:
        """Limb, link, obstacle and missing room in the robot's terms."""
        robot = scene.robot
        name = f"{robot.limb_names[self.limb]}'s {robot.joint_name(self.limb, self.link)}"
        return (
            f"{name}, {1e3 * self.radius:.0f} mm in radius, comes {1e3 * self.missing:.1f} mm too "
            f"close to {self.obstacle!r}"
        )


def limb_shortfall(scene: MotionScene, rounds: Rounds, instants: Instants) -> LimbShortfall | None:
    """Where standing limbs come closest to an obstacle or a scan, None where there is neither.

    Looked at along every push, from the placing of a limb to the next lift, and at the start.
    """
    if not scene.terrain.obstacles and scene.terrain.scan is None:
        return None
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    share = np.linspace(0.0, 1.0, _STEPS)[:, None]
    com, rpy = (
        x[lift, None] + share * (x[push] - x[lift])[:, None] for x in (instants.com, instants.rpy)
    )  # (P, S, 3)
    toes = np.broadcast_to(instants.toes[push, None], (*com.shape[:2], scene.robot.limb_count, 3))
    normals = np.broadcast_to(instants.normal[push, None], toes.shape)
    # At the start all stand where the first instant has them, or left from there
    first = instants.normal[:1]
    start = instants.com[:1], instants.rpy[:1], rounds.toes[:1], first
    flat_toes, flat_normals = (v.reshape(-1, *v.shape[2:]) for v in (toes, normals))
    flat = (com.reshape(-1, 3), rpy.reshape(-1, 3), flat_toes, flat_normals)
    links = world_capsules(scene, *(np.concatenate(both) for both in zip(start, flat, strict=True)))
    obstacles = scene.terrain.obstacles

    def shortfall(
        missing: float, index: tuple[int, ...], link: int, radius: float, name: str
    ) -> LimbShortfall:
        pose, limb = index
        where = "start posture"
        if pose > 0:
            where = instants.label(int(push[(pose - 1) // _STEPS]), scene.robot.limb_names)
        return LimbShortfall(missing, where, limb, link, radius, name)

    short = []
    if obstacles:
        found = closest_link(obstacles, links, BETWEEN, scene.terrain.stood_upon)
        name = obstacles[found.obstacle].name
        missing = BETWEEN - found.distance
        short.append(shortfall(missing, found.index, found.link, found.radius, name))
    if scene.terrain.scan is not None:
        contacts = Contacts(
            np.concatenate([start[2], flat_toes])[..., None, :],
            np.concatenate([first, flat_normals])[..., None, :],
        )
        raw = nearest_raw(scene.terrain.scan, links, contacts, BETWEEN)
        nearest = shortfall(raw.missing, raw.index, raw.link, raw.radius, THE_SCAN)
        short.append(replace(nearest, solids=raw.solids))
    return max(short, key=lambda s: s.missing)


def limb_points(scene: MotionScene, com: Array, rpy: Array, toes: Array) -> Array:
    """Joints and toes (P, N, J + 1, 3) of limbs for toes (P, N, 3), world; NaN out of reach.

    Of feet that are not flat.
    """
    robot = scene.robot
    angles = inverse(robot, to_body(com, rpy, toes)).best()
    points = joint_points_body(robot, angles)
    return com[:, None, None] + np.einsum("kab,knjb->knja", rotation_world_body(rpy), points)


def world_capsules(
    scene: MotionScene, com: Array, rpy: Array, toes: Array, normal: Array
) -> Capsules:
    """Links (P, N, C) of limbs for toes (P, N, 3), world; NaN out of reach.

    normal: (P, N, 3) of the surfaces under the toes.
    """
    angles = standing_inverse(scene.robot, com, rpy, toes, normal).best()
    return limb_capsules(scene.robot, angles).moved(com, rotation_world_body(rpy))


def narrowed(links: Capsules) -> Array:
    """Ends (..., N, C, 3) of links where they narrow to toes; NaN for what is all narrow."""
    back = np.maximum(NARROW - links.to_toe, 0.0)[..., None]
    along = links.starts - links.ends
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    shorter = links.ends + along * np.minimum(back / np.maximum(length, 1e-9), 1.0)
    return np.where((back > 0) & (back >= length), np.nan, shorter)


@dataclass(frozen=True)
class Closest:
    """The link closest to an obstacle among many."""

    distance: float  # [m] of its surface
    index: tuple[int, ...]  # of pose and limb
    link: int
    radius: float  # [m]
    obstacle: int


def closest_link(
    obstacles: tuple[Solid, ...], links: Capsules, enough: float, stood_upon: Mask
) -> Closest:
    """The least distance of links, as thick as they are, from obstacles; those with NaN left out.

    Distances beyond `enough` [m] are lower bounds. stood_upon: (N, O) obstacles that limbs may
    stand on, to which the last part of a tibia, that narrows to its toe, may come close.
    """
    shorter = narrowed(links)
    axes_apart = float(links.radius.max()) + enough
    distance = np.stack(
        [
            link_distances(
                solid,
                links.starts,
                np.where(stood_upon[..., o, None, None], shorter, links.ends),
                axes_apart,
            )
            - links.radius
            for o, solid in enumerate(obstacles)
        ],
        axis=-1,
    )
    distance = np.where(np.isnan(distance), np.inf, distance)
    *index, own, obstacle = (
        int(i) for i in np.unravel_index(int(np.argmin(distance)), distance.shape)
    )
    which = index[-1], own
    return Closest(
        float(distance.min()),
        tuple(index),
        int(links.link[which]),
        float(links.radius[which]),
        obstacle,
    )


def link_distances(solid: Solid, starts: Array, ends: Array, enough: float = np.inf) -> Array:
    """Distances (...) of segments (..., 3) from a convex solid, negative where they meet it.

    A segment that a face parts from the solid by `enough` [m] gets that lower bound instead. Where
    they meet, the value is minus the way out across a face.
    """
    flat = np.stack([starts.reshape(-1, 3), ends.reshape(-1, 3)])
    faces = flat @ solid.A.T - solid.b  # (2, S, F)
    distance = faces.min(axis=0).max(axis=1)
    near = distance < enough
    if near.any():
        distance[near] = _near_distances(solid, flat[:, near], faces[:, near], distance[near])
    return np.asarray(distance.reshape(starts.shape[:-1]))


def _near_distances(solid: Solid, flat: Array, faces: Array, bound: Array) -> Array:
    """Exact distances (S,) of segments with ends (2, S, 3), face distances (2, S, F) of their ends.

    Apart, the nearest points lie on an edge of the solid or at an end of the segment before a face.
    """
    best = _edge_distances(solid, *flat)
    for end, distance in zip(flat, faces, strict=True):
        foot = end[:, None] - distance[..., None] * solid.A  # (S, F, 3)
        on_face = (foot @ solid.A.T - solid.b).max(axis=-1) <= _TOUCHING
        best = np.minimum(best, np.where(on_face & (distance >= 0), distance, np.inf).min(axis=1))
    return np.where((bound < 0) & _meets(faces), bound, best)


def _meets(faces: Array) -> Mask:
    """Whether segments with face distances (2, S, F) at their ends pass through the solid (S,)."""
    first, last = faces
    slope = last - first
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -first / slope
    enter = np.where(slope < 0, crossing, -np.inf).max(axis=1)
    leave = np.where(slope > 0, crossing, np.inf).min(axis=1)
    beside = ((slope == 0) & (first > 0)).any(axis=1)
    return np.asarray(~beside & (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)))


def _edge_distances(solid: Solid, starts: Array, ends: Array) -> Array:
    """Least distance (S,) of segments from all edges of a solid."""
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
