"""Random fields of stepping stones."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.schema.terrain import SteppingStonesSpec


def drawn_stones(spec: SteppingStonesSpec) -> tuple[list[str], Array, Array]:
    """Names, corners (S, 4, 2) counterclockwise and heights (S,) [m] of the stones that are there.

    A stone has the same turn and height whatever else is missing. Names count missing ones, too.
    """
    rng = np.random.default_rng(spec.seed)
    most = np.deg2rad(spec.turn_deg)
    half = 0.5 * spec.size * float(np.cos(most) + np.sin(most))  # of a stone that is turned most
    along, across = (
        a + half + spec.pitch * np.arange(int((b - a - 2 * half) / spec.pitch + 1e-9) + 1)
        for a, b in (spec.x, spec.y)
    )
    middle = np.stack(np.meshgrid(along, across, indexing="ij"), axis=-1).reshape(-1, 2)
    turn = most * rng.uniform(-1, 1, len(middle))
    height = spec.rise * rng.uniform(-1, 1, len(middle))
    there = rng.permutation(len(middle)) >= round(spec.missing * len(middle))
    square = 0.5 * spec.size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    corners = middle[:, None, :] + square @ np.swapaxes(rotation, -1, -2)
    names = [f"S{k + 1}" for k in np.flatnonzero(there)]
    return names, corners[there], height[there]
