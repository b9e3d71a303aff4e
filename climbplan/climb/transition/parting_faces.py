"""Faces that keep limbs off the terrain and the body in the program of a motion, pinned.

A joint is beyond the face of a solid that leaves it most room where the search has it, and a link
beyond the face of the body's parts that does. Limbs that are not looked at there have a face of
zeros, which everything is beyond.
"""

from __future__ import annotations

import numpy as np

from climbplan.climb.plan.climb_plan import Array, Index, Mask
from climbplan.climb.self_clearance import body_solids
from climbplan.climb.transition.scene import TransitionScene
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.kinematics import inverse
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.touching_parts import parts_beside

_ROOM = 0.01  # [m] of joints beside solids
_APART = 2e-3  # [m] of links beside the body


def parting_faces(
    scene: TransitionScene, com: Array, rpy: Array, toes: Array, asked: Mask
) -> dict[str, Array]:
    """Numbers of the program, (M, d) each, for poses (M, 3) and toes (M, P, N, 3), body frame.

    asked: (M, P, N) which limbs are looked at.
    """
    robot = scene.robot
    solution = inverse(robot, toes)
    angles = np.where(solution.valid[..., None], solution.best(), solution.angles[..., 0, :, :])
    turn = np.swapaxes(rotation_world_body(rpy), -1, -2)[:, None, None]
    points = com[:, None, None, None] + robot.limbs.joint_points(angles)[..., 1:-1, :] @ turn
    m = len(com)
    faces, ends = [], []
    for solid in scene.terrain.solids:
        room = points @ solid.A.T - solid.b  # (M, P, N, J - 1, F)
        best = room.argmax(axis=-1)
        on = asked[..., None]
        # No more is asked of a joint than it has where the search has it
        most = np.minimum(_ROOM, np.maximum(room.max(axis=-1), 0.0))
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


def _picked(values: list[Array], which: Index) -> Array:
    """Of arrays (..., k) alike the one that `which` (...) names."""
    stacked = np.stack(values)
    index = which[None] if stacked.ndim == which.ndim + 1 else which[None, ..., None]
    return np.asarray(np.take_along_axis(stacked, index, axis=0)[0])
