"""Books as rectangles in the plane: corners, extents, distance and depth of overlap.

Vectorised: `pose` (..., 3) x, y, angle and `size` (..., 2) height, width broadcast against each
other; lengths in any one unit.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray

ANGLE_LIMIT = 1e-4  # [rad] moves a corner by about as much


def compute_corners(pose: Array, size: Array) -> Array:
    """Compute corners (..., 4, 2), eq. (8.1): top right, bottom right, bottom left, top left."""
    half_height, half_width = size[..., 0, None] / 2, size[..., 1, None] / 2
    along = np.array([1.0, 1.0, -1.0, -1.0]) * half_width
    up = np.array([1.0, -1.0, -1.0, 1.0]) * half_height
    c, s = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    x = pose[..., 0, None] + c * along - s * up
    y = pose[..., 1, None] + s * along + c * up
    return np.stack([x, y], axis=-1)


def compute_half_extents(angle: Array, size: Array) -> Array:
    """Compute half width and half height (..., 2) of a tilted book's axis-aligned box."""
    c, s = np.abs(np.cos(angle)), np.abs(np.sin(angle))
    height, width = size[..., 0], size[..., 1]
    return np.stack([(width * c + height * s) / 2, (width * s + height * c) / 2], axis=-1)


def compute_separation(pose_a: Array, size_a: Array, pose_b: Array, size_b: Array) -> Array:
    """Compute the largest gap (...) along a face normal of either rectangle.

    It is minus the penetration depth of rectangles that overlap. That is exact by the separating
    axis theorem: the smallest translation that separates them is along one of the face normals.
    """
    gaps = []
    for angle in (pose_a[..., 2], pose_b[..., 2]):
        for turn in (0.0, np.pi / 2):
            normal = np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=-1)
            between = np.abs(((pose_b[..., :2] - pose_a[..., :2]) * normal).sum(axis=-1))
            reach = _compute_half_extent(pose_a, size_a, normal) + _compute_half_extent(
                pose_b, size_b, normal
            )
            gaps.append(between - reach)
    return np.max(gaps, axis=0)


def compute_distance(pose_a: Array, size_a: Array, pose_b: Array, size_b: Array) -> Array:
    """Compute the distance (...) between two rectangles, zero if they overlap.

    The nearest points of two convex polygons that do not meet include a corner of one of them.
    """
    apart = compute_separation(pose_a, size_a, pose_b, size_b) > 0
    from_a = _measure_distance_to(compute_corners(pose_a, size_a), pose_b, size_b).min(axis=-1)
    from_b = _measure_distance_to(compute_corners(pose_b, size_b), pose_a, size_a).min(axis=-1)
    return np.where(apart, np.minimum(from_a, from_b), 0.0)


def _compute_half_extent(pose: Array, size: Array, normal: Array) -> Array:
    """Compute half of the rectangle's extent along `normal` (..., 2)."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    along = np.abs(normal[..., 0] * c + normal[..., 1] * s)
    up = np.abs(normal[..., 1] * c - normal[..., 0] * s)
    reach: Array = (size[..., 1] * along + size[..., 0] * up) / 2
    return reach


def _measure_distance_to(points: Array, pose: Array, size: Array) -> Array:
    """Measure the distance (..., K) of points (..., K, 2) from a rectangle."""
    c, s = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    offset = points - pose[..., None, :2]
    along = np.abs(offset[..., 0] * c + offset[..., 1] * s) - size[..., 1, None] / 2
    up = np.abs(offset[..., 1] * c - offset[..., 0] * s) - size[..., 0, None] / 2
    return np.hypot(np.maximum(along, 0), np.maximum(up, 0))


def find_slots(pose: Array, size: Array) -> IntArray:
    """Find the slot (S,) of the inserted book: the number of stored books whose foot is left."""
    feet = find_ground_contact(pose, size)
    return (feet[:, :-1] < feet[:, -1:]).sum(axis=1)


def find_ground_contact(pose: Array, size: Array) -> Array:
    """Find x of the ground contact (...,) [m]; flat and upright books have it in their middle."""
    angle = pose[..., 2]
    c, s = np.cos(angle), np.sin(angle)
    lever = (size[..., 0] * np.abs(s) - size[..., 1] * c) / 2
    tilted = np.minimum(np.abs(s), np.abs(c)) > ANGLE_LIMIT
    foot: Array = pose[..., 0] + np.where(tilted, np.sign(s) * lever, 0.0)
    return foot
