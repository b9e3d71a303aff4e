"""Links against obstacles in the posture NLP: one parting plane for each pair.

A link and a convex obstacle are apart if a plane parts them. The plane's direction is pinned for
a run of IPOPT, chosen where the links are in its start, and touches the obstacle, so that the
rows left for the NLP are linear in the link's ends.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.terrain.solids import Solid

_TOUCHING = 1e-6  # [m] a corner this close to a face belongs to it


def parting_planes(solid: Solid, starts: Array, ends: Array) -> Array:
    """The plane (..., 4) of each link that leaves most room to a solid, or overlaps least.

    starts, ends: (..., 3) ends of the links [m]. A plane is a unit normal away from the solid and
    its offset, touching the solid. Directions are those of its faces, and between faces for edges
    and corners.
    """
    directions = _directions(solid)
    offsets = (solid.vertices @ directions.T).max(axis=0)
    room = np.minimum(starts @ directions.T, ends @ directions.T) - offsets
    best = room.argmax(axis=-1)
    return np.concatenate([directions[best], offsets[best][..., None]], axis=-1)


def _directions(solid: Solid) -> Array:
    """Unit normals of faces, and means of those that meet at an edge or a corner, (D, 3)."""
    touching = np.abs(solid.A @ solid.vertices.T - solid.b[:, None]) < _TOUCHING  # (F, V)
    first, second = np.nonzero(np.triu(touching.astype(int) @ touching.T >= 2, k=1))
    sums = np.vstack([solid.A, solid.A[first] + solid.A[second], touching.T @ solid.A])
    unit: Array = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    return unit
