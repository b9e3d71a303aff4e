"""The terrain of a world: surfaces that lie a little elsewhere, and solids they are faces of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.simulation.world import World
from climbplan.terrain.model import Terrain
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Surface, Tube


def moved_terrain(terrain: Terrain, world: World) -> Terrain:
    """Surfaces shifted, turned and with their own friction; obstacles go with what lies on them.

    Raises UsageError where toes stand on the triangles of a scan, which are one piece.
    """
    own = world.surface.any() or world.tilt.any() or (world.friction != 1.0).any()
    if terrain.scan is not None and own:
        raise UsageError(
            "the triangles of a scan are one piece: worlds of this plan need uncertainty.friction, "
            "surface_mm and surface_tilt_deg 0"
        )
    surfaces = tuple(
        _moved(surface, world, index) for index, surface in enumerate(terrain.surfaces)
    )
    obstacles = list(terrain.obstacles)
    for o, solid in enumerate(terrain.obstacles):
        on = [r for r, surface in enumerate(terrain.surfaces) if _is_face(surface, solid)]
        if on:
            first = terrain.surfaces[on[0]]
            assert isinstance(first, Region)
            obstacles[o] = _solid_moved(solid, first, *_motion(first, world, on[0]))
    return replace(terrain, surfaces=surfaces, obstacles=tuple(obstacles))


def material(terrain: Terrain, radius: float) -> Array:
    """(G, F, 4) rows of A and b of solids {A x <= b}: slabs of flat surfaces, then obstacles.

    They are as the middles of toes of a radius [m] meet them: larger by it, but for the front of a
    slab, which lies so much behind where toes are planned to stand, unless these stand off it.
    Solids of fewer faces are padded with rows 0 x <= 1.
    """
    flat = [s for s in terrain.surfaces if isinstance(s, Region)]
    slabs = [s.slab() for s in flat]
    solids = [*slabs, *terrain.obstacles]
    rows = np.zeros((len(solids), max((len(s.b) for s in solids), default=1), 4))
    rows[:, :, 3] = 1.0
    for g, solid in enumerate(solids):
        rows[g, : len(solid.b), :3], rows[g, : len(solid.b), 3] = solid.A, solid.b + radius
    rows[: len(slabs), 0, 3] -= [0.0 if s.standoff else radius for s in flat]
    return rows


def _motion(region: Region, world: World, index: int) -> tuple[Array, Array]:
    """Rotation (3, 3) about the region's middle, and shift (3,)."""
    shift = world.surface[index] * region.normal
    tilt = world.tilt[index]
    if not tilt.any():
        return np.eye(3), shift
    edge = region.vertices[1] - region.vertices[0]
    first = edge / np.linalg.norm(edge)
    turn = tilt[0] * first + tilt[1] * np.cross(region.normal, first)
    angle = float(np.linalg.norm(turn))
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross, shift


def _moved(surface: Surface, world: World, index: int) -> Surface:
    friction = float(surface.friction * world.friction[index])
    if isinstance(surface, Tube):
        return replace(
            surface, friction=friction, radius=float(surface.radius - world.surface[index])
        )
    assert isinstance(surface, Region)
    if not world.tilt[index].any() and world.surface[index] == 0.0:
        return replace(surface, friction=friction)
    rotation, shift = _motion(surface, world, index)
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


def _solid_moved(solid: Solid, region: Region, rotation: Array, shift: Array) -> Solid:
    middle = region.vertices.mean(axis=0)
    A = solid.A @ rotation.T
    return replace(
        solid,
        vertices=(solid.vertices - middle) @ rotation.T + middle + shift,
        A=A,
        b=solid.b + A @ (middle + shift) - solid.A @ middle,
    )


def _is_face(surface: Surface, solid: Solid) -> bool:
    """Whether a flat surface covers part of a face of a solid."""
    if not isinstance(surface, Region):
        return False
    distance = surface.material @ solid.A.T - solid.b
    on = np.abs(distance).max(axis=0) < 1e-6
    return bool((distance < 1e-6).all() and (on & (solid.A @ surface.normal > 0)).any())
