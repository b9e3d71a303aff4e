"""Detect collisions of toes with the terrain, and project toes to its surfaces.

The terrain consists of convex solids {A x <= b}, which are slabs behind flat regions and obstacles,
and of round tubes.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.state import TerrainGeometry

TUBE = -2  # face index of a tube
SURFACE_TOLERANCE = 1e-5  # [m] from a face within which a toe is on it
EDGE_TOLERANCE = 2e-3  # [m] from the edge of a solid within which an adjacent one continues it


@compiled
def _find_first_hit(
    start: Array, end: Array, ground: TerrainGeometry, inflation: float, excluded: int
) -> tuple[int, int, float]:
    """Find the first solid or tube that a toe hits on the segment from start (3,) to end (3,).

    inflation: [m] by which solids are enlarged. excluded: index of a solid to ignore, or -1.
    Returns solid, face and the fraction of the segment up to the hit; solid -1 without a hit.
    """
    solids, tubes = ground.solids, ground.tubes
    solid, face, hit_fraction = -1, -1, 2.0
    for g in range(len(solids)):
        if g == excluded:
            continue
        # Clip the segment by the half-spaces of the solid
        entry_face, entry_fraction, exit_fraction = -1, 0.0, 1.0
        nearest_face, nearest_distance = 0, -np.inf
        for f in range(solids.shape[1]):
            row = solids[g, f]
            end_distance = row[0] * end[0] + row[1] * end[1] + row[2] * end[2] - row[3] - inflation
            start_distance = (
                row[0] * start[0] + row[1] * start[1] + row[2] * start[2] - row[3] - inflation
            )
            if start_distance > -SURFACE_TOLERANCE:
                if end_distance >= 0.0:
                    exit_fraction = -1.0
                    break
                fraction = (
                    start_distance / (start_distance - end_distance)
                    if start_distance > 0.0
                    else 0.0
                )
                if entry_face < 0 or fraction > entry_fraction:
                    entry_face, entry_fraction = f, fraction
            elif end_distance > 0.0:
                exit_fraction = min(exit_fraction, start_distance / (start_distance - end_distance))
            if start_distance > nearest_distance:
                nearest_face, nearest_distance = f, start_distance
        if entry_fraction > exit_fraction or entry_fraction >= hit_fraction:
            continue
        solid, hit_fraction = g, entry_fraction
        face = entry_face if entry_face >= 0 else nearest_face
    if solid >= 0:
        return solid, face, hit_fraction
    for u in range(len(tubes)):
        tube = tubes[u]
        if tube[3] <= end[2] <= tube[4]:
            radius = np.hypot(end[0] - tube[0], end[1] - tube[1])
            if radius > tube[2] - inflation:
                start_radius = np.hypot(start[0] - tube[0], start[1] - tube[1])
                fraction = (
                    (tube[2] - start_radius) / (radius - start_radius)
                    if radius > start_radius
                    else 0.0
                )
                return u, TUBE, min(max(fraction, 0.0), 1.0)
    return -1, -1, 0.0


@compiled
def _project_to_surface(
    position: Array, solid: int, face: int, ground: TerrainGeometry, normal: Array
) -> None:
    """Move a position (3,) to its surface, in place, and set the normal, into free space."""
    if face == TUBE:
        tube = ground.tubes[solid]
        x, y = position[0] - tube[0], position[1] - tube[1]
        radius = np.hypot(x, y)
        normal[0], normal[1], normal[2] = -x / radius, -y / radius, 0.0
        position[0], position[1] = tube[0] + x / radius * tube[2], tube[1] + y / radius * tube[2]
        return
    row = ground.solids[solid, face]
    for i in range(3):
        normal[i] = row[i]
    depth = row[0] * position[0] + row[1] * position[1] + row[2] * position[2] - row[3]
    for i in range(3):
        position[i] -= depth * row[i]


@compiled
def _has_left_face(position: Array, solid: int, face: int, ground: TerrainGeometry) -> bool:
    """Return whether a position on a face lies beyond the bounds of the face."""
    if face == TUBE:
        return not ground.tubes[solid, 3] <= position[2] <= ground.tubes[solid, 4]
    for f in range(ground.solids.shape[1]):
        if f != face:
            row = ground.solids[solid, f]
            if (
                row[0] * position[0] + row[1] * position[1] + row[2] * position[2] - row[3]
                > SURFACE_TOLERANCE
            ):
                return True
    return False
