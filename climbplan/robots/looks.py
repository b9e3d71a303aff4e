"""How a robot looks: triangles carried by its body and by the links of its limbs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.robots.serial_chain import SerialChain

BODY = -1  # limb of what the body carries


@dataclass(frozen=True)
class Looks:
    """Triangles in the body frame at zero joint angles; a triangle's corners have one carrier."""

    vertices: Array  # (V, 3) [m]
    faces: IntArray  # (F, 3) rows of vertices
    limb: IntArray  # (V,) that carries a vertex, BODY for the body
    joint: IntArray  # (V,) of that limb, beyond which the vertex lies; 0 on the body


@dataclass(frozen=True)
class Piece:
    """What one link carries, about the link's joint; of the body, about its origin."""

    limb: int
    joint: int
    vertices: Array  # (V, 3) [m]
    faces: IntArray  # (F, 3)


def pieces_of(looks: Looks, chain: SerialChain) -> tuple[Piece, ...]:
    """The looks, one piece a carrier."""
    found = []
    carriers = np.unique(np.stack([looks.limb, looks.joint], axis=1), axis=0)
    for limb, joint in carriers.tolist():
        own = (looks.limb == limb) & (looks.joint == joint)
        row = np.cumsum(own) - 1
        faces = row[looks.faces[own[looks.faces[:, 0]]]]
        about = np.zeros(3) if limb == BODY else chain.joint_zero[limb, joint]
        found.append(Piece(limb, joint, looks.vertices[own] - about, faces))
    return tuple(found)


def piece_places(
    pieces: tuple[Piece, ...], chain: SerialChain, angles: Array
) -> tuple[Array, Array]:
    """Where pieces are in the body frame at angles (..., N, J): (..., K, 3) [m], (..., K, 3, 3).

    By the same product of exponentials as joints and toes.
    """
    pose = chain.pose(angles)
    batch = angles.shape[:-2]
    place = np.zeros((*batch, len(pieces), 3))
    rotation = np.broadcast_to(np.eye(3), (*batch, len(pieces), 3, 3)).copy()
    for k, piece in enumerate(pieces):
        if piece.limb != BODY:
            place[..., k, :] = pose.places[..., piece.limb, piece.joint, :]
            rotation[..., k, :, :] = pose.turns[..., piece.limb, piece.joint, :, :]
    return place, rotation
