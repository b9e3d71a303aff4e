"""Build terrain as MuJoCo geoms: flat surfaces, tubes, obstacles, triangles of scans.

Toes are small spheres about the planned toe points, so surfaces lie their radius deeper than
planned.
"""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.model.toe import TOE_RADIUS
from climbplan.simulation.attributes import format_numbers
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import SLAB_THICKNESS, Region, Surface, Tube

_SCAN_RADIUS = 0.15  # [m] about toes in which raw triangles of a scan are simulated
_PRISM_DEPTH = 0.02  # [m] of material behind them
_NUM_STAVES = 96  # flat pieces of a tube

# Collision classes: toes, links and the body meet all terrain.
TOE, LINK, BODY = 1, 2, 4


def build_geom(name: str, shape: str, friction: float, *, color: str = "wall") -> str:
    """Build a static geom of the terrain."""
    return (
        f'<geom name={quoteattr(name)} {shape} friction="{max(friction, 1e-5):.6g} 0 0"'
        f' contype="0" conaffinity="{TOE | LINK | BODY}" material="{color}"/>'
    )


def build_surface_geoms(
    index: int, surface: Surface, factor: float, assets: list[str]
) -> list[str]:
    """Build the geoms of a surface with a factor on its friction; meshes are added to `assets`."""
    name, friction = f"surface{index}", surface.friction * factor
    if isinstance(surface, Tube):
        return _build_tube(name, surface, friction)
    assert isinstance(surface, Region)
    vertices = surface.vertices - _compute_depth(surface) * surface.normal
    edges = np.roll(vertices, -1, axis=0) - vertices
    corners = np.abs(np.einsum("ki,ki->k", edges, np.roll(edges, -1, axis=0)))
    if len(vertices) == 4 and corners.max() < 1e-9:
        width, height = np.linalg.norm(edges[0]), np.linalg.norm(edges[1])
        axes = np.stack([edges[0] / width, edges[1] / height, surface.normal], axis=1)
        center = vertices.mean(axis=0) - SLAB_THICKNESS / 2 * surface.normal
        half = np.array([width, height, SLAB_THICKNESS]) / 2
        return [build_geom(name, _format_box(center, axes, half), friction)]
    corners_of_slab = np.vstack([vertices, vertices - SLAB_THICKNESS * surface.normal])
    return [
        build_geom(name, add_mesh(name, Solid.from_points(name, corners_of_slab), assets), friction)
    ]


def _compute_depth(surface: Surface) -> float:
    """Compute how far behind the planned places of toes a surface lies [m].

    Surfaces with a standoff, for wrists and feet of finite size, lie where they are.
    """
    return surface.standoff if surface.standoff else TOE_RADIUS


def build_scan_geoms(
    scan: RawSurface, toes: Array, friction: float, assets: list[str], depth: float
) -> list[str]:
    """Build the triangles of a scan near toes (..., 3) as thin prisms.

    Their fronts lie `depth` behind the triangles [m]: the radius of toes that are planned as
    points.
    """
    corners = scan.corners
    low, high = corners.min(axis=1) - _SCAN_RADIUS, corners.max(axis=1) + _SCAN_RADIUS
    places = np.unique(np.round(toes.reshape(-1, 3), 3), axis=0)
    is_near = np.zeros(len(corners), bool)
    for place in places:
        is_near |= ((place >= low) & (place <= high)).all(axis=1)
    lines = []
    for t in np.flatnonzero(is_near):
        cross_product = np.cross(corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0])
        normal = cross_product / np.linalg.norm(cross_product)
        front = corners[t] - depth * normal
        name = f"scan{t}"
        assets.append(_build_prism(name, np.vstack([front, front - _PRISM_DEPTH * normal])))
        shape = f'type="mesh" mesh="{name}" pos="{format_numbers(front.mean(axis=0))}"'
        lines.append(build_geom(name, shape, friction))
    return lines


def _build_prism(name: str, vertices: Array) -> str:
    """Build a triangle's prism as a mesh about the center of its front."""
    centered = vertices - vertices[:3].mean(axis=0)
    return f'<mesh name="{name}" inertia="shell" vertex="{format_numbers(centered)}"/>'


def _format_box(center: Array, axes: Array, half: Array) -> str:
    """Format the attributes of a box; axes: (3, 3), columns are its axes in the world."""
    return (
        f'type="box" pos="{format_numbers(center)}" size="{format_numbers(half)}"'
        f' xyaxes="{format_numbers(axes[:, 0])} {format_numbers(axes[:, 1])}"'
    )


def add_mesh(name: str, solid: Solid, assets: list[str]) -> str:
    """Add the mesh of a solid to `assets` and return the attributes of its geom."""
    center = solid.vertices.mean(axis=0)
    assets.append(f'<mesh name="{name}" vertex="{format_numbers(solid.vertices - center)}"/>')
    # MuJoCo moves a mesh's vertices to its own centre and principal axes, and back where it stands.
    return f'type="mesh" mesh="{name}" pos="{format_numbers(center)}"'


def _build_tube(name: str, tube: Tube, friction: float) -> list[str]:
    """Build flat staves whose inner faces touch the tube, the toe's radius further out."""
    lines = []
    radius = tube.radius + _compute_depth(tube)
    half = np.array(
        [radius * np.tan(np.pi / _NUM_STAVES), (tube.upper - tube.lower) / 2, SLAB_THICKNESS / 2]
    )
    # Midway between the circles through the corners and the middles of the faces
    apothem = radius * (1 + np.cos(np.pi / _NUM_STAVES)) / 2
    for stave in range(_NUM_STAVES):
        angle = 2 * np.pi * stave / _NUM_STAVES
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        axes = np.stack([[-outward[1], outward[0], 0.0], [0.0, 0.0, 1.0], outward], axis=1)
        center = np.array([*tube.center, (tube.lower + tube.upper) / 2], float)
        center = center + (apothem + SLAB_THICKNESS / 2) * outward
        lines.append(build_geom(f"{name}.{stave}", _format_box(center, axes, half), friction))
    return lines
