"""Spherical feet on the ground: whether its pieces have room for them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import shapely

from climbplan.arrays import Array
from climbplan.walking.task.ground import Ground

_FAR = np.full(2, 1e4)  # [m] beyond all ground
_STEP = 1e-3  # [m] that a foot rolls over


def too_near(ground: Ground, foot: float) -> Iterator[str]:
    """Why feet of a radius [m] do not fit the ground's `edge`: one reason of each kind.

    A foot whose centre is nearer than its radius to higher ground stands in that ground's side.
    """
    if foot == 0 or ground.count == 1:
        return
    shapes = np.array([shapely.polygons(_outline(ground, k)) for k in range(ground.count)])
    inner = shapely.buffer(shapes, -ground.edge) if ground.edge else shapes
    if (narrow := np.flatnonzero(shapely.is_empty(inner))).size:
        name = ground.names[int(narrow[0])]
        yield f"feet of {foot:g} m have no room within the edges of {name!r}, expected less"
    if ground.edge >= foot - 1e-9:
        return
    one, other = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=foot)
    one, other = one[one != other], other[one != other]
    ends = shapely.get_coordinates(shapely.shortest_line(shapes[one], shapes[other]))
    here, there = ends.reshape(-1, 2, 2).swapaxes(0, 1)
    rise = ground.level_at(other, there) - ground.level_at(one, here)
    if (rise > _STEP).any():
        k = int(np.argmax(rise))
        yield (
            f"feet of {foot:g} m stand in the side of {ground.names[other[k]]!r}, {rise[k]:.3g} m "
            f"above {ground.names[one[k]]!r}: expected at least their radius"
        )


def _outline(ground: Ground, region: int) -> Array:
    outline: Array = ground.outline(region, -_FAR, _FAR)[:, :2]
    return outline
