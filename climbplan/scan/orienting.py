"""Surfaces turned to face free space, as seen from a place that is free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.scan.cleaning import components, ordered
from climbplan.scan.raw import RawScan

_INSIDE = 0.5  # share of all directions in which a closed surface is seen from within
_SHEET = 0.5  # share of its area by which a surface faces one way, if it is a sheet


def facing(raw: RawScan, place: Array) -> RawScan:
    """Every connected surface with its front to free space, which `place` (3,) belongs to.

    A sheet turns its front to the place; a body its outside, unless the place is within it.
    """
    if not len(raw.triangles):
        return raw
    surface = components(raw.triangles)
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(doubled, axis=1) / 2

    def summed(values: Array) -> Array:
        return np.asarray(np.bincount(surface, weights=values), float)

    seen = summed(_solid_angles(corners - place)) / (4 * np.pi)  # > 0: backs
    vector = np.column_stack([summed(doubled[:, k]) for k in range(3)]) / 2
    total = summed(area)
    sheet = np.linalg.norm(vector, axis=1) > _SHEET * total
    middles = corners.mean(axis=1)
    centre = np.column_stack([summed(area * middles[:, k]) for k in range(3)]) / total[:, None]
    volume = summed(((middles - centre[surface]) * doubled).sum(axis=1))
    within = np.abs(seen) > _INSIDE
    wrong = np.where(sheet | within, seen > 0, volume < 0)
    if not wrong.any():
        return raw
    turn = wrong[surface]
    triangles = np.where(turn[:, None], raw.triangles[:, ::-1], raw.triangles)
    noun = "surface" if wrong.sum() == 1 else "surfaces"
    return ordered(replace(raw, triangles=triangles)).noted(
        f"{int(wrong.sum())} {noun} of {int(turn.sum())} triangles turned to face free space"
    )


def _solid_angles(corners: Array) -> Array:
    """(T,) solid angles of triangles (T, 3, 3) from the origin, positive from behind.

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
