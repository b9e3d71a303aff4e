"""Faces that keep limbs off terrain, body and one another in the program of a motion, pinned.

A joint is beyond the face of a solid that leaves it most room where the search has it, and a link
beyond the face of the body's parts that does. Links of two limbs are on both sides of a plane that
is square to the shortest way between them. Limbs that are not looked at there have a face of zeros,
which everything is beyond.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.limb_pairs import body_solids
from climbplan.climb.transition.scene import TransitionScene
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.kinematics import inverse
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.touching_parts import limbs_room, limbs_ways, parts_beside

LinkPairs = tuple[tuple[int, int, int, int], ...]  # limb and capsule, and limb and capsule

_ROOM = 0.01  # [m] of joints beside solids, at least
_APART = 2e-3  # [m] of links beside the body and beside one another
_NEAR = 0.03  # [m] room between links of two limbs up to which rows part them
_CROSSED = 1e-9  # [m] a shorter way has no direction


def parting_faces(
    scene: TransitionScene, com: Array, rpy: Array, toes: Array, asked: BoolArray
) -> dict[str, Array]:
    """Numbers of the program, (M, d) each, for poses (M, 3) and toes (M, P, N, 3), body frame.

    asked: (M, P, N) which limbs are looked at.
    """
    robot = scene.robot
    angles = _angles_at(scene, toes)
    turn = np.swapaxes(rotation_world_body(rpy), -1, -2)[:, None, None]
    points = com[:, None, None, None] + robot.limbs.joint_points(angles)[..., 1:-1, :] @ turn
    m = len(com)
    faces, ends = [], []
    keep_off = np.maximum(_ROOM, _thickness(robot) + _APART)  # (N, J - 1)
    for solid in scene.terrain.solids:
        room = points @ solid.A.T - solid.b  # (M, P, N, J - 1, F)
        best = room.argmax(axis=-1)
        on = asked[..., None]
        # No more is asked of a joint than it has where the search has it
        most = np.minimum(keep_off, np.maximum(room.max(axis=-1), 0.0))
        faces.append(np.where(on[..., None], solid.A[best], 0.0))
        ends.append(np.where(on, solid.b[best] + most, -1.0))
    links = limb_capsules(robot, angles)
    pairs, _ = parts_beside(robot, links)
    own = pairs[:, 0], pairs[:, 1]
    face = np.zeros((*angles.shape[:-1], links.radius.shape[1], 3))
    end = np.full(face.shape[:-1], -1.0)
    both = np.stack([links.starts, links.ends], axis=-2)[..., own[0], own[1], :, :]
    choices = []
    for part in body_solids(robot):
        room = (both @ part.A.T - part.b).min(axis=-2)  # (M, P, B, F)
        choices.append((room.max(axis=-1), part.A[room.argmax(-1)], part.b[room.argmax(-1)]))
    radius = links.radius[own]
    on = asked[..., own[0]]
    # One face for each link: of the part that is nearest
    nearest = np.argmin([room for room, _, _ in choices], axis=0)
    room, normal, offset = (_picked([c[k] for c in choices], nearest) for k in range(3))
    keep = np.minimum(radius + _APART, np.maximum(room, 0.0))
    face[..., own[0], own[1], :] = np.where(on[..., None], normal, 0.0)
    end[..., own[0], own[1]] = np.where(on, offset + keep, -1.0)
    # Columns: point by point, solid by solid, joint by joint or link by link, limb by limb
    by_solid = np.stack(faces, axis=2), np.stack(ends, axis=2)  # (M, P, S, N, J - 1, ...)
    return {
        "joint_face": np.swapaxes(by_solid[0], 3, 4).reshape(m, -1),
        "joint_end": np.swapaxes(by_solid[1], 3, 4).reshape(m, -1),
        "link_face": np.swapaxes(face, 2, 3).reshape(m, -1),
        "link_end": np.swapaxes(end, 2, 3).reshape(m, -1),
    }


def links_near(scene: TransitionScene, toes: Array, moved: BoolArray) -> LinkPairs:
    """Links of two limbs that come close, toes (M, P, N, 3), body frame, moved (M, N).

    Limbs that do not move in a round stay at its first point.
    """
    links = limb_capsules(scene.robot, _staying(_angles_at(scene, toes), moved))
    _, pairs = parts_beside(scene.robot, links)
    room = limbs_room(links, pairs)  # (M, P, Q)
    near = (room < _NEAR).any(axis=(0, 1))
    return tuple((int(i), int(c), int(k), int(d)) for i, c, k, d in pairs[near])


def parting_planes(
    scene: TransitionScene, toes: Array, asked: BoolArray, moved: BoolArray, beside: LinkPairs
) -> dict[str, Array]:
    """Numbers of the program, (M, d) each, that part the links of two limbs; arguments as above.

    No more is asked of links than they have where the search has them.
    """
    if not beside:
        return {}
    pairs = np.array(beside, np.int64)
    links = limb_capsules(scene.robot, _staying(_angles_at(scene, toes), moved))
    way, room = limbs_ways(links, pairs), limbs_room(links, pairs)  # (M, P, Q, ...)
    length = np.linalg.norm(way, axis=-1)
    asked = np.where(moved[:, None], asked, asked[:, :1])
    on = asked[..., pairs[:, 0]] | asked[..., pairs[:, 2]]
    # Past the first point only a pair of which one moves is anywhere else
    goes = moved[:, pairs[:, 0]] | moved[:, pairs[:, 2]]
    on[:, 1:] &= goes[:, None]
    on &= length > _CROSSED
    face = np.where(on[..., None], way / np.maximum(length, _CROSSED)[..., None], 0.0)
    end = np.where(on, length - room + np.minimum(_APART, np.maximum(room, 0.0)), -1.0)
    m = len(toes)
    return {
        "limb_face": face.reshape(m, -1),
        "limb_end": end.reshape(m, -1),
        "moves": moved.astype(float),
    }


def _angles_at(scene: TransitionScene, toes: Array) -> Array:
    """Joint angles (..., N, J) for toes (..., N, 3), body frame; the nearest where out of reach."""
    solution = inverse(scene.robot, toes)
    first = solution.angles[..., 0, :, :]
    return np.where(solution.valid[..., None], solution.best(), first)


def _staying(angles: Array, moved: BoolArray) -> Array:
    """Angles (M, P, N, J), of limbs that do not move those of the first point."""
    return np.where(moved[:, None, :, None], angles, angles[:, :1])


def _thickness(robot: Robot) -> Array:
    """(N, J - 1) radius [m] of what is about each joint but the first: links to it and from it."""
    shape = robot.limb_count, robot.joint_count - 1
    if robot.capsules is None:
        return np.full(shape, robot.limb_radius)
    thick = np.zeros((robot.limb_count, robot.joint_count))
    limb = np.broadcast_to(np.arange(robot.limb_count)[:, None], robot.capsules.joint.shape)
    np.maximum.at(thick, (limb, robot.capsules.joint), robot.capsules.radius)
    return np.maximum(thick[:, :-1], thick[:, 1:])


def _picked(values: list[Array], which: IntArray) -> Array:
    """Of arrays (..., k) alike the one that `which` (...) names."""
    stacked = np.stack(values)
    index = which[None] if stacked.ndim == which.ndim + 1 else which[None, ..., None]
    return np.asarray(np.take_along_axis(stacked, index, axis=0)[0])
