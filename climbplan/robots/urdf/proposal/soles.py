"""Soles of legs: the level face under a last body, by the URDF's own collision geometry.

The face is square to the axes of the toe's link, as the robot file states soles. Points within
3 mm of it bear load: corners of boxes, points of meshes, the lowest points of spheres, which many
robots have at the corners of their feet. A sole is the largest rectangle about the middle of
these, with the aspect ratio of their extents, whose corners lie in their convex hull.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.proposal.toes import Toe, build_toe
from climbplan.robots.urdf.shapes import CollisionShape

_FACE_TOLERANCE = 3e-3  # [m] from the face, of points that bear load
_MIN_SIZE = 0.02  # [m] of length and width, of robots that are not small
_MIN_SIZE_RATIO = 0.06  # of these over the distance from hip to ankle, of small robots
_MAX_SIZE_DIFFERENCE = 0.05  # relative, between soles of a robot
_DIGITS_PER_METRE = 1e3  # sizes are whole millimetres


@dataclass(frozen=True)
class Soles:
    """Flat feet of one size at the ends of N legs."""

    toes: tuple[Toe, ...]  # (N,) in the middles of soles
    length: float  # [m] along
    width: float  # [m] across
    axes_zero: Array  # (N, 3, 3) columns across, along, normal at zero angles, base frame


def find_soles(
    urdf_model: UrdfModel, names: Sequence[str], toes: Sequence[Toe], shapes: list[CollisionShape]
) -> Soles | None:
    """Find the soles of legs.

    Args:
        urdf_model: The robot.
        names: Its legs, N of them.
        toes: (N,) toes.
        shapes: All collision geometry.

    Returns:
        The soles; None where a leg has none, or they differ in size.
    """
    centred, sizes, rotations = [], [], []
    for name, toe in zip(names, toes, strict=True):
        leg = urdf_model.read_leg(name)
        leg_shapes = [shape for shape in shapes if shape.joint == leg.names[-1]]
        face = _find_sole_face(leg, leg_shapes)
        if face is None:
            return None
        middle, size, rotation = face
        centred.append(
            build_toe(urdf_model, toe.link, middle, "the middle of its sole, by collision geometry")
        )
        sizes.append(size)
        rotations.append(rotation)
    min_size, max_size = np.min(sizes, axis=0), np.max(sizes, axis=0)
    if (max_size > (1 + _MAX_SIZE_DIFFERENCE) * min_size).any():
        return None
    width, length = (
        float(np.floor(_DIGITS_PER_METRE * size) / _DIGITS_PER_METRE) for size in min_size
    )
    return Soles(tuple(centred), length, width, np.array(rotations))


def _find_sole_face(
    leg: LegAtZero, shapes: list[CollisionShape]
) -> tuple[Array, Array, Array] | None:
    """Return middle (3,), size (2,) lateral and forward [m], and axes (3, 3) of a leg's sole.

    shapes: those of its last body. None where there is no face of sufficient size.
    """
    if not shapes:
        return None
    hip, ankle = leg.joints[0], leg.joints[-1]
    directions = np.concatenate([leg.toe_axes, -leg.toe_axes], axis=1)
    down = directions[:, int(np.argmin((hip - ankle) @ directions))]  # away from the hip
    level_axes = directions[:, np.abs(down @ directions) < 0.5]
    forward = level_axes[:, int(np.argmax(level_axes[1]))]  # forward
    rotation = np.stack([np.cross(forward, -down), forward, -down], axis=-1)
    points = np.concatenate([shape.points + shape.radius * down for shape in shapes])
    heights = points @ down
    bearing = points[heights > heights.max() - _FACE_TOLERANCE]
    footprint = bearing @ rotation[:, :2]  # (P, 2) across, along
    low, high = footprint.min(axis=0), footprint.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    size = 2 * half * _compute_supported_fraction(footprint, middle, half)
    min_size = min(_MIN_SIZE, _MIN_SIZE_RATIO * float(np.linalg.norm(hip - ankle)))
    if (size < min_size).any():
        return None
    return rotation[:, :2] @ middle + heights.max() * down, size, rotation


def _compute_supported_fraction(points: Array, middle: Array, half: Array) -> float:
    """Return the scale of a rectangle whose corners lie in the hull of points (P, 2).

    middle: (2,) of the rectangle; half: (2,) its half extents [m].
    """
    if (half <= 0).any():
        return 0.0
    try:
        hull = ConvexHull(points)
    except QhullError:  # on a line
        return 0.0
    normal, offset = hull.equations[:, :2], hull.equations[:, 2]
    distance = -(normal @ middle + offset)
    return float(np.clip((distance / (np.abs(normal) @ half)).min(), 0.0, 1.0))
