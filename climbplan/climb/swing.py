"""Swing paths: how a toe moves clear of the terrain from one contact to the next."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from climbplan.climb.scene import ClimbScene
from climbplan.errors import Conflict, Infeasible
from climbplan.robots.rotations import Array
from climbplan.terrain.solids import Solid

TOE_CLEARANCE = 0.01  # [m] distance a swinging toe keeps from every solid
_SAMPLE = 0.005  # [m] spacing of the points at which a path is checked
_RAISES = (1.0, 1.5, 2.0, 3.0)  # factors on the lift that are tried in turn


def _blocking(path: Array, solids: Sequence[Solid]) -> Solid | None:
    """The solid that a polyline (P, 3) comes closest to within the clearance, if any."""
    pieces = [path[:1]]
    for start, end in itertools.pairwise(path):
        count = max(2, int(np.ceil(np.linalg.norm(end - start) / _SAMPLE)) + 1)
        share = np.linspace(0.0, 1.0, count)[1:, None]
        pieces.append(start + share * (end - start))
    points = np.concatenate(pieces)
    # The face distance never exceeds the true distance, so a clear path is really clear.
    distances = [float(solid.face_distance(points).min()) for solid in solids]
    if not distances or min(distances) >= TOE_CLEARANCE - 1e-9:
        return None
    return solids[int(np.argmin(distances))]


def swing_path(scene: ClimbScene, old: Array, new: Array, normals: Array, where: str) -> Array:
    """Way points (P, 3) from above the old contact to above the new one.

    old, new: (3,) contacts; normals: (2, 3) their unit normals. The straight path is tried first,
    then higher lifts, then a detour further out. Raises Infeasible naming what blocks the way.
    """
    lift = scene.spec.trajectory.lift
    solids = scene.terrain.solids
    blocked: Solid | None = None
    outward = normals.sum(axis=0)
    length = float(np.linalg.norm(outward))
    outward = outward / length if length > 1e-9 else normals[0]
    hover = np.stack([old + lift * normals[0], new + lift * normals[1]])
    for factor in _RAISES:
        ends = np.stack([old + factor * lift * normals[0], new + factor * lift * normals[1]])
        middle = ends.mean(axis=0) + factor * lift * outward
        for path in (ends, np.stack([ends[0], middle, ends[1]])):
            blocked = _blocking(path, solids)
            if blocked is None:
                if factor == 1.0:
                    return path
                return np.concatenate([hover[:1], path, hover[1:]])
    name = blocked.name if blocked is not None else "terrain"
    raise Infeasible(
        "no clear swing path",
        [Conflict(where, (f"swing path of the toe past {name!r}",), ("another posture or lift",))],
    )
