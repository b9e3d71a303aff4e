"""How far the centre of a spherical foot moves while it rolls without sliding."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array


def rolled(radius: float, links: Array, normal: Array) -> Array:
    """(S, 3) of the centre since the first of S samples [m].

    links: (S, 3, 3) of the foot's link to the world, little turned from one to the next; normal:
    (3,) of the surface. The point that touches stands still, so that the centre's velocity is that
    of the link's turning times the radius along the normal.
    """
    change = links[1:] @ np.swapaxes(links[:-1], -1, -2)
    odd = change - np.swapaxes(change, -1, -2)
    turn = np.stack([odd[:, 2, 1], odd[:, 0, 2], odd[:, 1, 0]], axis=-1) / 2
    moved = np.cumsum(radius * np.cross(turn, normal), axis=0)
    return np.concatenate([np.zeros((1, 3)), moved])
