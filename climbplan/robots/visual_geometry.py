"""Visual geometry of a robot: triangles carried by its body and by the links of its limbs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.robots.serial_chain import SerialChain

BODY = -1  # limb number of what the body carries


@dataclass(frozen=True)
class VisualGeometry:
    """Triangles in the body frame at zero joint angles; a triangle's corners have one carrier."""

    vertices: Array  # (V, 3) [m]
    faces: IntArray  # (F, 3) rows of vertices
    limb: IntArray  # (V,) that carries a vertex, BODY for the body
    joint: IntArray  # (V,) of that limb, beyond which the vertex lies; 0 on the body


@dataclass(frozen=True)
class Piece:
    """The triangles on one link, about the link's joint; of the body, about its origin."""

    limb: int
    joint: int
    vertices: Array  # (V, 3) [m]
    faces: IntArray  # (F, 3)


def split_by_link(geometry: VisualGeometry, chain: SerialChain) -> tuple[Piece, ...]:
    """Return the visual geometry, one piece for each link that carries any."""
    pieces = []
    carriers = np.unique(np.stack([geometry.limb, geometry.joint], axis=1), axis=0)
    for limb, joint in carriers.tolist():
        on_link = (geometry.limb == limb) & (geometry.joint == joint)
        row = np.cumsum(on_link) - 1
        faces = row[geometry.faces[on_link[geometry.faces[:, 0]]]]
        origin = np.zeros(3) if limb == BODY else chain.joint_zero[limb, joint]
        pieces.append(Piece(limb, joint, geometry.vertices[on_link] - origin, faces))
    return tuple(pieces)


def compute_piece_poses(
    pieces: tuple[Piece, ...], chain: SerialChain, angles: Array
) -> tuple[Array, Array]:
    """Return positions (..., K, 3) [m] and rotations (..., K, 3, 3) of pieces in the body frame.

    They follow from the same product of exponentials as joints and toes.

    Args:
        pieces: K pieces.
        chain: The limbs.
        angles: Joint angles (..., N, J) [rad].
    """
    pose = chain.pose(angles)
    batch = angles.shape[:-2]
    position = np.zeros((*batch, len(pieces), 3))
    rotation = np.broadcast_to(np.eye(3), (*batch, len(pieces), 3, 3)).copy()
    for k, piece in enumerate(pieces):
        if piece.limb != BODY:
            position[..., k, :] = pose.places[..., piece.limb, piece.joint, :]
            rotation[..., k, :, :] = pose.turns[..., piece.limb, piece.joint, :, :]
    return position, rotation
