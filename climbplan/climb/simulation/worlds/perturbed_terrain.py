"""The terrain of a world: surfaces and the solids behind them, moved by small errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.simulation.world import World
from climbplan.terrain.model import Terrain
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Surface, Tube


def perturb_terrain(terrain: Terrain, world: World) -> Terrain:
    """Move and tilt the surfaces of a terrain and scale their friction, as in a world.

    Obstacles move with the surface that is a face of theirs.

    Raises:
        UsageError: The terrain is a scan, whose triangles cannot move separately.
    """
    is_perturbed = world.surface.any() or world.tilt.any() or (world.friction != 1.0).any()
    if terrain.scan is not None and is_perturbed:
        raise UsageError(
            "the triangles of a scan are one piece: worlds of this plan need uncertainty.friction, "
            "surface_mm and surface_tilt_deg 0"
        )
    surfaces = tuple(
        _perturb_surface(surface, world, index) for index, surface in enumerate(terrain.surfaces)
    )
    obstacles = list(terrain.obstacles)
    for o, solid in enumerate(terrain.obstacles):
        face_indices = [
            r for r, surface in enumerate(terrain.surfaces) if _covers_face(surface, solid)
        ]
        if face_indices:
            first = terrain.surfaces[face_indices[0]]
            assert isinstance(first, Region)
            obstacles[o] = _transform_solid(
                solid, first, *_compute_motion(first, world, face_indices[0])
            )
    return replace(terrain, surfaces=surfaces, obstacles=tuple(obstacles))


def build_collision_solids(terrain: Terrain, radius: float) -> Array:
    """Build the solids {A x <= b} that toes collide with: slabs of surfaces, then obstacles.

    Solids are enlarged by the radius of toes [m], so that toes are points. The front of a slab is
    not: it lies a radius behind the planned places of toes, unless the surface has a standoff.

    Returns:
        (G, F, 4) rows of A and b; solids of fewer faces are padded with rows 0 x <= 1.
    """
    regions = [s for s in terrain.surfaces if isinstance(s, Region)]
    slabs = [s.slab() for s in regions]
    solids = [*slabs, *terrain.obstacles]
    rows = np.zeros((len(solids), max((len(s.b) for s in solids), default=1), 4))
    rows[:, :, 3] = 1.0
    for g, solid in enumerate(solids):
        rows[g, : len(solid.b), :3], rows[g, : len(solid.b), 3] = solid.A, solid.b + radius
    rows[: len(slabs), 0, 3] -= [0.0 if s.standoff else radius for s in regions]
    return rows


def _compute_motion(region: Region, world: World, index: int) -> tuple[Array, Array]:
    """Compute the rotation (3, 3) about the region's center, and the shift (3,) [m]."""
    shift = world.surface[index] * region.normal
    tilt = world.tilt[index]
    if not tilt.any():
        return np.eye(3), shift
    edge = region.vertices[1] - region.vertices[0]
    first = edge / np.linalg.norm(edge)
    rotation_vector = tilt[0] * first + tilt[1] * np.cross(region.normal, first)
    angle = float(np.linalg.norm(rotation_vector))
    x, y, z = rotation_vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross, shift


def _perturb_surface(surface: Surface, world: World, index: int) -> Surface:
    friction = float(surface.friction * world.friction[index])
    if isinstance(surface, Tube):
        return replace(
            surface, friction=friction, radius=float(surface.radius - world.surface[index])
        )
    assert isinstance(surface, Region)
    if not world.tilt[index].any() and world.surface[index] == 0.0:
        return replace(surface, friction=friction)
    rotation, shift = _compute_motion(surface, world, index)
    middle = surface.vertices.mean(axis=0)
    corners = (surface.vertices - middle) @ rotation.T + middle + shift
    normal, A = rotation @ surface.normal, surface.A @ rotation.T
    return replace(
        surface,
        vertices=corners,
        normal=normal,
        offset=float(normal @ corners.mean(axis=0)),
        A=A,
        b=np.einsum("ij,ij->i", A, corners),
        friction=friction,
    )


def _transform_solid(solid: Solid, region: Region, rotation: Array, shift: Array) -> Solid:
    middle = region.vertices.mean(axis=0)
    A = solid.A @ rotation.T
    return replace(
        solid,
        vertices=(solid.vertices - middle) @ rotation.T + middle + shift,
        A=A,
        b=solid.b + A @ (middle + shift) - solid.A @ middle,
    )


def _covers_face(surface: Surface, solid: Solid) -> bool:
    """Return whether a flat surface covers part of a face of a solid."""
    if not isinstance(surface, Region):
        return False
    distance = surface.material @ solid.A.T - solid.b
    on = np.abs(distance).max(axis=0) < 1e-6
    return bool((distance < 1e-6).all() and (on & (solid.A @ surface.normal > 0)).any())
