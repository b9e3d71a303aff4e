"""Soles of legs: the level face under a last body, by the URDF's own collision geometry.

The face is looked for square to the axes of the toe's link, as the robot file states soles. What
lies within 3 mm of it bears: corners of boxes, points of meshes, the lowest points of spheres,
which many robots have at the corners of their feet. A sole is the largest rectangle about the
middle of these, of the shape of their extents, whose corners their hull holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.proposal.toes import Toe, toe_at
from climbplan.robots.urdf.shapes import Shape

_LEVEL = 3e-3  # [m] of the face that bears
_SMALLEST = 0.02  # [m] of length and width
_ALIKE = 0.05  # by which soles of a robot may differ
_DIGITS = 1e3  # sizes are whole millimetres


@dataclass(frozen=True)
class Soles:
    """Flat feet of one size at the ends of N legs."""

    toes: tuple[Toe, ...]  # (N,) in the middles of soles
    length: float  # [m] along
    width: float  # [m] across
    axes_zero: Array  # (N, 3, 3) columns across, along, normal at zero angles, base frame


def soles_of(
    found: UrdfModel, names: Sequence[str], toes: Sequence[Toe], shapes: list[Shape]
) -> Soles | None:
    """Soles of legs by name; None where one has none, or they differ in size."""
    out, sizes, axes = [], [], []
    for name, toe in zip(names, toes, strict=True):
        leg = found.leg(name)
        own = [shape for shape in shapes if shape.joint == leg.names[-1]]
        face = _face(leg, own)
        if face is None:
            return None
        middle, size, turn = face
        out.append(toe_at(found, toe.link, middle, "the middle of its sole, by collision geometry"))
        sizes.append(size)
        axes.append(turn)
    least, most = np.min(sizes, axis=0), np.max(sizes, axis=0)
    if (most > (1 + _ALIKE) * least).any():
        return None
    width, length = (float(np.floor(_DIGITS * size) / _DIGITS) for size in least)
    return Soles(tuple(out), length, width, np.array(axes))


def _face(leg: LegAtZero, own: list[Shape]) -> tuple[Array, Array, Array] | None:
    """Middle (3,), size (2,) across and along [m], and axes (3, 3) of the sole of a leg."""
    if not own:
        return None
    hip, ankle = leg.joints[0], leg.joints[-1]
    both = np.concatenate([leg.toe_axes, -leg.toe_axes], axis=1)
    down = both[:, int(np.argmin((hip - ankle) @ both))]  # away from the hip
    square = both[:, np.abs(down @ both) < 0.5]
    along = square[:, int(np.argmax(square[1]))]  # forward
    turn = np.stack([np.cross(along, -down), along, -down], axis=-1)
    points = np.concatenate([shape.points + shape.radius * down for shape in own])
    level = points @ down
    bears = points[level > level.max() - _LEVEL]
    flat = bears @ turn[:, :2]  # (P, 2) across, along
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    size = 2 * half * _held(flat, middle, half)
    if (size < _SMALLEST).any():
        return None
    return turn[:, :2] @ middle + level.max() * down, size, turn


def _held(points: Array, middle: Array, half: Array) -> float:
    """The share of a rectangle about its middle whose corners lie in the hull of points (P, 2)."""
    if (half <= 0).any():
        return 0.0
    try:
        hull = ConvexHull(points)
    except QhullError:  # on a line
        return 0.0
    normal, offset = hull.equations[:, :2], hull.equations[:, 2]
    room = -(normal @ middle + offset)
    return float(np.clip((room / (np.abs(normal) @ half)).min(), 0.0, 1.0))
