"""Terrain as MuJoCo geoms: flat surfaces, tubes, obstacles, raw triangles of scans.

Toes are small spheres about the planned toe points, so surfaces lie their radius deeper than
planned.
"""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.model.toe import TOE_RADIUS
from climbplan.simulation.attributes import numbers
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import SLAB_THICKNESS, Region, Surface, Tube

_AROUND = 0.15  # [m] about toes in which raw triangles of a scan are simulated
_PRISM = 0.02  # [m] of material behind them
_STAVES = 96  # flat pieces of a tube

# Collision classes: toes, links and the body meet all terrain.
TOE, LINK, BODY = 1, 2, 4


def terrain_geom(name: str, shape: str, friction: float, *, color: str = "wall") -> str:
    return (
        f'<geom name={quoteattr(name)} {shape} friction="{max(friction, 1e-5):.6g} 0 0"'
        f' contype="0" conaffinity="{TOE | LINK | BODY}" material="{color}"/>'
    )


def surface_geoms(index: int, surface: Surface, factor: float, assets: list[str]) -> list[str]:
    name, friction = f"surface{index}", surface.friction * factor
    if isinstance(surface, Tube):
        return _tube(name, surface, friction)
    assert isinstance(surface, Region)
    vertices = surface.vertices - _deeper(surface) * surface.normal
    edges = np.roll(vertices, -1, axis=0) - vertices
    corners = np.abs(np.einsum("ki,ki->k", edges, np.roll(edges, -1, axis=0)))
    if len(vertices) == 4 and corners.max() < 1e-9:
        width, height = np.linalg.norm(edges[0]), np.linalg.norm(edges[1])
        axes = np.stack([edges[0] / width, edges[1] / height, surface.normal], axis=1)
        center = vertices.mean(axis=0) - SLAB_THICKNESS / 2 * surface.normal
        half = np.array([width, height, SLAB_THICKNESS]) / 2
        return [terrain_geom(name, _box(center, axes, half), friction)]
    deep = np.vstack([vertices, vertices - SLAB_THICKNESS * surface.normal])
    return [terrain_geom(name, mesh_shape(name, Solid.from_points(name, deep), assets), friction)]


def _deeper(surface: Surface) -> float:
    """How far behind the places of toes a surface is met [m].

    What wrists and feet of finite size stay off is drawn and met where it is.
    """
    return surface.standoff if surface.standoff else TOE_RADIUS


def raw_geoms(
    scan: RawSurface, toes: Array, friction: float, assets: list[str], behind: float
) -> list[str]:
    """The raw triangles of a scan as thin prisms, those within a stride of toes (..., 3).

    Their fronts are so far behind the triangles [m]: the radius of toes that are planned as points,
    so that these stand on them.
    """
    corners = scan.corners
    low, high = corners.min(axis=1) - _AROUND, corners.max(axis=1) + _AROUND
    places = np.unique(np.round(toes.reshape(-1, 3), 3), axis=0)
    near = np.zeros(len(corners), bool)
    for place in places:
        near |= ((place >= low) & (place <= high)).all(axis=1)
    out = []
    for t in np.flatnonzero(near):
        doubled = np.cross(corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0])
        normal = doubled / np.linalg.norm(doubled)
        front = corners[t] - behind * normal
        name = f"scan{t}"
        assets.append(_prism(name, np.vstack([front, front - _PRISM * normal])))
        shape = f'type="mesh" mesh="{name}" pos="{numbers(front.mean(axis=0))}"'
        out.append(terrain_geom(name, shape, friction))
    return out


def _prism(name: str, vertices: Array) -> str:
    """A triangle's prism as a mesh about the middle of its front."""
    own = vertices - vertices[:3].mean(axis=0)
    return f'<mesh name="{name}" inertia="shell" vertex="{numbers(own)}"/>'


def _box(center: Array, axes: Array, half: Array) -> str:
    """axes: (3, 3), columns the box's axes in the world."""
    return (
        f'type="box" pos="{numbers(center)}" size="{numbers(half)}"'
        f' xyaxes="{numbers(axes[:, 0])} {numbers(axes[:, 1])}"'
    )


def mesh_shape(name: str, solid: Solid, assets: list[str]) -> str:
    center = solid.vertices.mean(axis=0)
    assets.append(f'<mesh name="{name}" vertex="{numbers(solid.vertices - center)}"/>')
    # MuJoCo moves a mesh's vertices to its own centre and principal axes, and back where it stands.
    return f'type="mesh" mesh="{name}" pos="{numbers(center)}"'


def _tube(name: str, tube: Tube, friction: float) -> list[str]:
    """Staves whose inner faces touch the tube, the toe's radius further out."""
    out = []
    radius = tube.radius + _deeper(tube)
    half = np.array(
        [radius * np.tan(np.pi / _STAVES), (tube.upper - tube.lower) / 2, SLAB_THICKNESS / 2]
    )
    # Midway between the circles through the corners and the middles of the faces
    inner = radius * (1 + np.cos(np.pi / _STAVES)) / 2
    for stave in range(_STAVES):
        angle = 2 * np.pi * stave / _STAVES
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        axes = np.stack([[-outward[1], outward[0], 0.0], [0.0, 0.0, 1.0], outward], axis=1)
        center = np.array([*tube.center, (tube.lower + tube.upper) / 2], float)
        center = center + (inner + SLAB_THICKNESS / 2) * outward
        out.append(terrain_geom(f"{name}.{stave}", _box(center, axes, half), friction))
    return out
