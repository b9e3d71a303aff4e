"""Orientation of surfaces towards free space, as seen from a place that is free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.scan.cleaning import find_components, merge_corners
from climbplan.scan.raw import RawScan

_INSIDE_RATIO = 0.5  # of the solid angle that a closed surface fills, seen from inside
_SHEET_RATIO = 0.5  # vector area over area of a sheet


def orient_to_free_space(raw: RawScan, place: Array) -> RawScan:
    """Orient every connected surface with its front to free space.

    A sheet turns its front to the place; a body its outside, unless the place is inside.

    Args:
        raw: The surface.
        place: A point (3,) in free space [m].
    """
    if not len(raw.triangles):
        return raw
    surface = find_components(raw.triangles)
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(doubled, axis=1) / 2

    def sum_by_surface(values: Array) -> Array:
        return np.asarray(np.bincount(surface, weights=values), float)

    solid_angle = sum_by_surface(_compute_solid_angles(corners - place)) / (4 * np.pi)  # > 0: backs
    vector = np.column_stack([sum_by_surface(doubled[:, k]) for k in range(3)]) / 2
    total = sum_by_surface(area)
    sheet = np.linalg.norm(vector, axis=1) > _SHEET_RATIO * total
    middles = corners.mean(axis=1)
    centre = (
        np.column_stack([sum_by_surface(area * middles[:, k]) for k in range(3)]) / total[:, None]
    )
    volume = sum_by_surface(((middles - centre[surface]) * doubled).sum(axis=1))
    is_inside = np.abs(solid_angle) > _INSIDE_RATIO
    is_flipped = np.where(sheet | is_inside, solid_angle > 0, volume < 0)
    if not is_flipped.any():
        return raw
    flip = is_flipped[surface]
    triangles = np.where(flip[:, None], raw.triangles[:, ::-1], raw.triangles)
    noun = "surface" if is_flipped.sum() == 1 else "surfaces"
    return merge_corners(replace(raw, triangles=triangles)).add_notes(
        f"{int(is_flipped.sum())} {noun} of {int(flip.sum())} triangles turned to face free space"
    )


def _compute_solid_angles(corners: Array) -> Array:
    """Return the signed solid angles of triangles (T, 3, 3) from the origin, positive from behind.

    A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983).
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    below = (
        la * lb * lc
        + np.einsum("ij,ij->i", a, b) * lc
        + np.einsum("ij,ij->i", a, c) * lb
        + np.einsum("ij,ij->i", b, c) * la
    )
    return np.asarray(2 * np.arctan2(triple, below))
