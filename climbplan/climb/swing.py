"""Swing paths: how a toe moves clear of the terrain from one contact to the next.

The straight way between two hover points is tried first, then ways over one point aside, nearest
first. A way counts if the toe keeps its clearance, the limb reaches every point of it within its
joint bounds, and, where possible, the links miss the obstacles too.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.climb.scene import MotionScene
from climbplan.errors import Conflict, Infeasible
from climbplan.robots.kinematics import inverse, joint_points_body, to_body
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.terrain.solids import Solid

TOE_CLEARANCE = 0.01  # [m] distance a swinging toe keeps from every solid
_SPACING = 0.01  # [m] between the points at which a way is checked
_LIFTS = (1.0, 1.6, 2.4)  # factors on the spec's lift
_DETOURS = (0.06, 0.12, 0.18, 0.26)  # [m] how far aside the via points lie
_DIRECTIONS = np.array(
    [d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], float
)  # towards faces, edges and corners of a cube
_LINK_SHARES = np.linspace(0.0, 0.95, 8)  # points along a link, short of the toe


@dataclass(frozen=True)
class Swing:
    """One limb's move: the body stands still while the toe goes from old to new."""

    limb: int
    com: Array  # (3,) [m]
    rpy: Array  # (3,) [rad]
    old: Array  # (3,) contact left [m]
    new: Array  # (3,) contact reached [m]
    normals: Array  # (2, 3) unit normals at old and new
    where: str  # "round 3, LM lifted"


def swing_path(scene: MotionScene, swing: Swing) -> Array:
    """Way points (P, 3) from above the old contact to above the new one [m].

    Raises Infeasible naming what blocks the way.
    """
    solids = scene.terrain.solids
    lift = scene.spec.trajectory.lift
    hover = _hover(swing, lift)
    blocker: Solid | None = None
    second_best: Array | None = None
    for path in _candidates(swing, lift):
        points = _sampled(path)
        near = _nearest(points, solids)
        if near is not None:
            blocker = blocker or near
            continue
        links = _links(scene, swing, points)
        if links is None:
            continue
        whole = path if np.array_equal(path[[0, -1]], hover) else _joined(hover, path)
        if _nearest(links, scene.terrain.obstacles, scene.robot.limb_radius) is None:
            return whole
        if second_best is None:
            second_best = whole
    if second_best is not None:  # the exact limb check of the verification has the last word
        return second_best
    name = f"past {blocker.name!r}" if blocker is not None else "within the limb's reach"
    raise Infeasible(
        "no clear swing path",
        [Conflict(swing.where, (f"swing path of the toe {name}",))],
    )


def together(paths: list[Array]) -> Array:
    """Paths (P, limbs, 3) of as many points as the longest, for limbs that swing at once.

    Each keeps its own corners; points are added in the middle of its longest pieces.
    """
    count = max(len(path) for path in paths)
    out = []
    for way in paths:
        path = way
        while len(path) < count:
            piece = int(np.argmax(np.linalg.norm(np.diff(path, axis=0), axis=1)))
            middle = path[piece : piece + 2].mean(axis=0)
            path = np.insert(path, piece + 1, middle, axis=0)
        out.append(path)
    return np.stack(out, axis=1)


def _hover(swing: Swing, height: float) -> Array:
    return np.stack([swing.old, swing.new]) + height * swing.normals


def _joined(hover: Array, path: Array) -> Array:
    return np.concatenate([hover[:1], path, hover[1:]])


def _candidates(swing: Swing, lift: float) -> Iterator[Array]:
    for factor in _LIFTS:
        ends = _hover(swing, factor * lift)
        yield ends
        middle = ends.mean(axis=0)
        for aside in _DETOURS:
            vias = middle + aside * _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1)[:, None]
            length = np.linalg.norm(vias[:, None] - ends, axis=2).sum(axis=1)
            for via in vias[np.argsort(length, kind="stable")]:
                yield np.stack([ends[0], via, ends[1]])


def _sampled(path: Array) -> Array:
    """Points (S, 3) along a polyline, its corners among them."""
    pieces = [path[:1]]
    for start, end in itertools.pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / _SPACING)))
        pieces.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(pieces)


def _nearest(
    points: Array, solids: tuple[Solid, ...], clearance: float = TOE_CLEARANCE
) -> Solid | None:
    """The solid that points (S, 3) come too close to, if any.

    The face distance never exceeds the true distance, so what passes here is really clear.
    """
    for solid in solids:
        if solid.face_distance(points).min() < clearance - 1e-9:
            return solid
    return None


def _links(scene: MotionScene, swing: Swing, toes: Array) -> Array | None:
    """Points (Q, 3) on femur and tibia along a way, or None if a point is out of reach."""
    robot = scene.robot
    stance = np.broadcast_to(robot.stance_body, (len(toes), robot.limb_count, 3)).copy()
    pose = np.broadcast_to(swing.com, toes.shape), np.broadcast_to(swing.rpy, toes.shape)
    stance[:, swing.limb] = to_body(*pose, toes[:, None])[:, 0]
    solution = inverse(robot, stance)
    if not solution.valid[:, swing.limb].all():
        return None
    angles = np.nan_to_num(solution.best())
    joints = joint_points_body(robot, angles)[:, swing.limb, 1:]  # (S, 3, 3) femur, knee, toe
    share = _LINK_SHARES[:, None, None, None]
    links = (1 - share) * joints[:, :-1] + share * joints[:, 1:]
    return swing.com + links.reshape(-1, 3) @ rotation_world_body(swing.rpy).T
