"""Where a toe meets terrain, and whether it is still there.

Terrain is convex solids {A x <= b}, the slabs behind flat regions and obstacles alike, and round
tubes.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.tuples import Ground

TUBE = -2  # number of the "face" of a tube
ON = 1e-5  # [m] within which a toe counts as on a face
BESIDE = 2e-3  # [m] within which the next solid goes on where one ends


@compiled
def _landed(
    before: Array, now: Array, ground: Ground, within: float, own: int
) -> tuple[int, int, float]:
    """Solid, face and part of the way at which a toe meets them from before to now; -1 if none.

    within: [m] by which solids are taken for larger. own: a solid that does not count, or -1.
    """
    solids, tubes = ground.solids, ground.tubes
    solid, face, first = -1, -1, 2.0
    for g in range(len(solids)):
        if g == own:
            continue
        # Where the way enters and leaves the solid, face by face
        found, enters, leaves = -1, 0.0, 1.0
        shallow, nearest = 0, -np.inf
        for f in range(solids.shape[1]):
            row = solids[g, f]
            end = row[0] * now[0] + row[1] * now[1] + row[2] * now[2] - row[3] - within
            start = row[0] * before[0] + row[1] * before[1] + row[2] * before[2] - row[3] - within
            if start > -ON:
                if end >= 0.0:
                    leaves = -1.0
                    break
                part = start / (start - end) if start > 0.0 else 0.0
                if found < 0 or part > enters:
                    found, enters = f, part
            elif end > 0.0:
                leaves = min(leaves, start / (start - end))
            if start > nearest:
                shallow, nearest = f, start
        if enters > leaves or enters >= first:
            continue
        solid, first = g, enters
        face = found if found >= 0 else shallow
    if solid >= 0:
        return solid, face, first
    for u in range(len(tubes)):
        tube = tubes[u]
        if tube[3] <= now[2] <= tube[4]:
            away = np.hypot(now[0] - tube[0], now[1] - tube[1])
            if away > tube[2] - within:
                first = np.hypot(before[0] - tube[0], before[1] - tube[1])
                part = (tube[2] - first) / (away - first) if away > first else 0.0
                return u, TUBE, min(max(part, 0.0), 1.0)
    return -1, -1, 0.0


@compiled
def _onto(place: Array, solid: int, face: int, ground: Ground, normal: Array) -> None:
    """Move a place onto its surface, in place, and tell the normal there, into free space."""
    if face == TUBE:
        tube = ground.tubes[solid]
        x, y = place[0] - tube[0], place[1] - tube[1]
        away = np.hypot(x, y)
        normal[0], normal[1], normal[2] = -x / away, -y / away, 0.0
        place[0], place[1] = tube[0] + x / away * tube[2], tube[1] + y / away * tube[2]
        return
    row = ground.solids[solid, face]
    for i in range(3):
        normal[i] = row[i]
    deep = row[0] * place[0] + row[1] * place[1] + row[2] * place[2] - row[3]
    for i in range(3):
        place[i] -= deep * row[i]


@compiled
def _beyond(place: Array, solid: int, face: int, ground: Ground) -> bool:
    """Whether a place on a surface has left its bounds."""
    if face == TUBE:
        return not ground.tubes[solid, 3] <= place[2] <= ground.tubes[solid, 4]
    for f in range(ground.solids.shape[1]):
        if f != face:
            row = ground.solids[solid, f]
            if row[0] * place[0] + row[1] * place[1] + row[2] * place[2] - row[3] > ON:
                return True
    return False
