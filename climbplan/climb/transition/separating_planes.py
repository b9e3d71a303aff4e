"""Fixed separating planes between limbs and terrain, body and one another, for the motion program.

A joint stays beyond the face of a solid from which it is farthest on the path of the search, and a
link beyond such a face of the body's parts. Links of two limbs are separated by a plane normal to
the shortest segment between them. Limbs that are not checked have a face of zeros, which is never
active.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.limb_pairs import build_body_solids
from climbplan.climb.transition.scene import TransitionScene
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.kinematics import solve_inverse_kinematics
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.self_clearance import (
    compute_limb_clearance,
    compute_limb_separations,
    list_clearance_pairs,
)

LinkPairs = tuple[tuple[int, int, int, int], ...]  # limb and capsule, and limb and capsule

_JOINT_CLEARANCE = 0.01  # [m] of joints from solids
_LINK_CLEARANCE = 2e-3  # [m] of links from the body and from one another
_NEAR_DISTANCE = 0.03  # [m] between links of two limbs, up to which they are separated
_MIN_DISTANCE = 1e-9  # [m] of a segment with a direction


def compute_separating_faces(
    scene: TransitionScene, com: Array, rpy: Array, toes: Array, checked: BoolArray
) -> dict[str, Array]:
    """Compute faces that separate joints from solids and links from the body.

    Args:
        scene: The scene.
        com: (M, 3) positions of the body [m].
        rpy: (M, 3) rotations [rad].
        toes: (M, P, N, 3) toes at the points of each round, body frame [m].
        checked: (M, P, N) bool, limb is checked at the point.

    Returns:
        Parameters of the program by name, (M, d) each.
    """
    robot = scene.robot
    angles = _solve_angles(scene, toes)
    rotation = np.swapaxes(rotation_world_body(rpy), -1, -2)[:, None, None]
    points = com[:, None, None, None] + robot.limbs.joint_points(angles)[..., 1:-1, :] @ rotation
    m = len(com)
    faces, offsets = [], []
    required_clearance = np.maximum(
        _JOINT_CLEARANCE, _compute_joint_radius(robot) + _LINK_CLEARANCE
    )  # (N, J - 1)
    for solid in scene.terrain.solids:
        distance = points @ solid.A.T - solid.b  # (M, P, N, J - 1, F)
        best = distance.argmax(axis=-1)
        is_checked = checked[..., None]
        # A joint is not required to be farther off than it is on the path of the search
        required = np.minimum(required_clearance, np.maximum(distance.max(axis=-1), 0.0))
        faces.append(np.where(is_checked[..., None], solid.A[best], 0.0))
        offsets.append(np.where(is_checked, solid.b[best] + required, -1.0))
    links = limb_capsules(robot, angles)
    pairs, _ = list_clearance_pairs(robot, links)
    limb_link = pairs[:, 0], pairs[:, 1]
    face = np.zeros((*angles.shape[:-1], links.radius.shape[1], 3))
    end = np.full(face.shape[:-1], -1.0)
    endpoints = np.stack([links.starts, links.ends], axis=-2)[..., limb_link[0], limb_link[1], :, :]
    choices = []
    for solid in build_body_solids(robot):
        distance = (endpoints @ solid.A.T - solid.b).min(axis=-2)  # (M, P, B, F)
        choices.append(
            (distance.max(axis=-1), solid.A[distance.argmax(-1)], solid.b[distance.argmax(-1)])
        )
    radius = links.radius[limb_link]
    is_checked = checked[..., limb_link[0]]
    # One face for each link: of the nearest part
    nearest = np.argmin([distance for distance, _, _ in choices], axis=0)
    distance, normal, offset = (_pick_entries([c[k] for c in choices], nearest) for k in range(3))
    required_distance = np.minimum(radius + _LINK_CLEARANCE, np.maximum(distance, 0.0))
    face[..., limb_link[0], limb_link[1], :] = np.where(is_checked[..., None], normal, 0.0)
    end[..., limb_link[0], limb_link[1]] = np.where(is_checked, offset + required_distance, -1.0)
    # Columns: point by point, solid by solid, joint by joint or link by link, limb by limb
    by_solid = np.stack(faces, axis=2), np.stack(offsets, axis=2)  # (M, P, S, N, J - 1, ...)
    return {
        "joint_face": np.swapaxes(by_solid[0], 3, 4).reshape(m, -1),
        "joint_end": np.swapaxes(by_solid[1], 3, 4).reshape(m, -1),
        "link_face": np.swapaxes(face, 2, 3).reshape(m, -1),
        "link_end": np.swapaxes(end, 2, 3).reshape(m, -1),
    }


def find_close_links(scene: TransitionScene, toes: Array, moves: BoolArray) -> LinkPairs:
    """Find links of two limbs that come close, for toes (M, P, N, 3), body frame, and moves (M, N).

    Limbs that do not move in a round stay at its first point.
    """
    links = limb_capsules(scene.robot, _freeze_standing_limbs(_solve_angles(scene, toes), moves))
    _, pairs = list_clearance_pairs(scene.robot, links)
    distance = compute_limb_clearance(links, pairs)  # (M, P, Q)
    is_near = (distance < _NEAR_DISTANCE).any(axis=(0, 1))
    return tuple((int(i), int(c), int(k), int(d)) for i, c, k, d in pairs[is_near])


def compute_separating_planes(
    scene: TransitionScene, toes: Array, checked: BoolArray, moves: BoolArray, link_pairs: LinkPairs
) -> dict[str, Array]:
    """Compute planes that separate the links of two limbs.

    Links are not required to be farther apart than they are on the path of the search.

    Args:
        scene: The scene.
        toes: (M, P, N, 3) toes at the points of each round, body frame [m].
        checked: (M, P, N) bool, limb is checked at the point.
        moves: (M, N) bool, limb moves in the round.
        link_pairs: Limb and capsule, and limb and capsule, to separate.

    Returns:
        Parameters of the program by name, (M, d) each.
    """
    if not link_pairs:
        return {}
    pairs = np.array(link_pairs, np.int64)
    links = limb_capsules(scene.robot, _freeze_standing_limbs(_solve_angles(scene, toes), moves))
    direction, distance = (
        compute_limb_separations(links, pairs),
        compute_limb_clearance(links, pairs),
    )  # (M, P, Q, ...)
    length = np.linalg.norm(direction, axis=-1)
    checked = np.where(moves[:, None], checked, checked[:, :1])
    is_active = checked[..., pairs[:, 0]] | checked[..., pairs[:, 2]]
    # After the first point only pairs with a moving limb are at another place
    is_moving = moves[:, pairs[:, 0]] | moves[:, pairs[:, 2]]
    is_active[:, 1:] &= is_moving[:, None]
    is_active &= length > _MIN_DISTANCE
    face = np.where(
        is_active[..., None], direction / np.maximum(length, _MIN_DISTANCE)[..., None], 0.0
    )
    offset = np.where(
        is_active, length - distance + np.minimum(_LINK_CLEARANCE, np.maximum(distance, 0.0)), -1.0
    )
    m = len(toes)
    return {
        "limb_face": face.reshape(m, -1),
        "limb_end": offset.reshape(m, -1),
        "moves": moves.astype(float),
    }


def _solve_angles(scene: TransitionScene, toes: Array) -> Array:
    """Solve joint angles (..., N, J) for toes (..., N, 3), body frame; nearest if out of reach."""
    solution = solve_inverse_kinematics(scene.robot, toes)
    first = solution.angles[..., 0, :, :]
    return np.where(solution.valid[..., None], solution.best(), first)


def _freeze_standing_limbs(angles: Array, moves: BoolArray) -> Array:
    """Return angles (M, P, N, J) with those of standing limbs fixed at the first point."""
    return np.where(moves[:, None, :, None], angles, angles[:, :1])


def _compute_joint_radius(robot: Robot) -> Array:
    """Compute the radius (N, J - 1) about each joint but the first: of the links that meet [m]."""
    shape = robot.limb_count, robot.joint_count - 1
    if robot.capsules is None:
        return np.full(shape, robot.limb_radius)
    radius = np.zeros((robot.limb_count, robot.joint_count))
    limb = np.broadcast_to(np.arange(robot.limb_count)[:, None], robot.capsules.joint.shape)
    np.maximum.at(radius, (limb, robot.capsules.joint), robot.capsules.radius)
    return np.maximum(radius[:, :-1], radius[:, 1:])


def _pick_entries(values: list[Array], selection: IntArray) -> Array:
    """Pick entries of arrays (..., k) of equal shape by the index of the array (...)."""
    stacked = np.stack(values)
    index = selection[None] if stacked.ndim == selection.ndim + 1 else selection[None, ..., None]
    return np.asarray(np.take_along_axis(stacked, index, axis=0)[0])
