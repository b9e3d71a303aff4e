"""The foothold regions of a spec: its own, stones, level ground, tops of boxes, those of a scan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely

from climbplan.arrays import Array
from climbplan.scan.convex import decompose_convex
from climbplan.walking.schema.region_plane import RegionPlane, is_axis_aligned
from climbplan.walking.schema.terrain import SteppingStonesSpec, WalkTerrainSpec
from climbplan.walking.task.ground import Ground

GROUND_NAME = "ground"


class TerrainRegion(NamedTuple):
    """A region as a spec states it."""

    name: str
    plane: RegionPlane
    friction: float | None = None  # None: that of the terrain
    limbs: tuple[str, ...] | None = None  # None: all may stand on it
    is_polygon: bool = False  # stated by corners, even if these are a rectangle


def sample_stones(spec: SteppingStonesSpec) -> tuple[list[str], Array, Array]:
    """Sample stepping stones on a grid with random angles and heights; some are missing.

    A stone has the same angle and height whatever other stones are missing. Names count missing
    stones, too.

    Args:
        spec: extents, pitch, size and ranges.

    Returns:
        Names, corners (S, 4, 2) counterclockwise [m], and heights (S,) [m].
    """
    rng = np.random.default_rng(spec.seed)
    max_angle = np.deg2rad(spec.turn_deg)
    # Half extent of a stone at the largest angle
    half = 0.5 * spec.size * float(np.cos(max_angle) + np.sin(max_angle))
    x_centres, y_centres = (
        a + half + spec.pitch * np.arange(int((b - a - 2 * half) / spec.pitch + 1e-9) + 1)
        for a, b in (spec.x, spec.y)
    )
    centres = np.stack(np.meshgrid(x_centres, y_centres, indexing="ij"), axis=-1).reshape(-1, 2)
    angle = max_angle * rng.uniform(-1, 1, len(centres))
    height = spec.rise * rng.uniform(-1, 1, len(centres))
    is_present = rng.permutation(len(centres)) >= round(spec.missing * len(centres))
    square = 0.5 * spec.size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    corners = centres[:, None, :] + square @ np.swapaxes(rotation, -1, -2)
    names = [f"S{k + 1}" for k in np.flatnonzero(is_present)]
    return names, corners[is_present], height[is_present]


def build_ground(spec: WalkTerrainSpec, foot: float = 0.0, leg_names: Sequence[str] = ()) -> Ground:
    """Build the regions and stones of a spec, or flat ground.

    Args:
        spec: The terrain.
        foot: Radius of spherical feet, 0 for points [m].
        leg_names: Names of the legs, which regions may name.
    """
    edge = spec.edge
    if edge is None:
        edge = foot if spec.scan is None else 0.0
    regions = list(generate_regions(spec))
    if not regions:
        return replace(Ground.flat(spec.friction), edge=edge)
    outlines = [np.array(region.plane.outline, float) for region in regions]
    angular = any(r.is_polygon or not is_axis_aligned(r.plane.outline) for r in regions)
    num_corners = max(map(len, outlines)) if angular else 0
    points = np.array([region.plane.point for region in regions], float)
    ground = Ground(
        tuple(region.name for region in regions),
        np.array([outline.min(axis=0) for outline in outlines]),
        np.array([outline.max(axis=0) for outline in outlines]),
        points[:, 2],
        spec.friction,
        np.array([region.plane.slope for region in regions], float),
        np.stack([_pad_outline(outline, num_corners) for outline in outlines]),
        edge,
    )
    rise = (ground.slope * (ground.inner - points[:, :2])).sum(axis=1)
    ground = replace(ground, height=ground.height + rise)
    if any(region.friction is not None for region in regions):
        coefficients = [spec.friction if r.friction is None else r.friction for r in regions]
        ground = replace(ground, region_friction=np.array(coefficients, float))
    if any(region.limbs is not None for region in regions):
        allowed = [[r.limbs is None or name in r.limbs for name in leg_names] for r in regions]
        ground = replace(ground, allowed=np.array(allowed, bool))
    return ground


def generate_regions(spec: WalkTerrainSpec) -> Iterator[TerrainRegion]:
    """Yield the regions of a spec: its own, level ground, tops of boxes, and stones."""
    for region in spec.regions:
        yield TerrainRegion(
            region.name, region.plane, region.friction, region.limbs, bool(region.corners)
        )
    yield from _split_level_ground(spec)
    for box in spec.boxes:
        (x0, y0, _), (x1, y1, top) = box.lower, box.upper
        corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
        plane = RegionPlane(corners, (0.0, 0.0), (x0, y0, top))
        yield TerrainRegion(box.name, plane, box.friction, box.limbs)
    if spec.stones is not None:
        is_turned = spec.stones.turn_deg > 0
        for name, corners, height in zip(*sample_stones(spec.stones), strict=True):
            outline = tuple((float(x), float(y)) for x, y in corners)
            plane = RegionPlane(outline, (0.0, 0.0), (0.0, 0.0, float(height)))
            yield TerrainRegion(name, plane, is_polygon=is_turned)


def _split_level_ground(spec: WalkTerrainSpec) -> Iterator[TerrainRegion]:
    """Yield the level ground without what boxes cover, in convex pieces."""
    ground = spec.ground
    if ground is None:
        return
    (x0, x1), (y0, y1) = ground.across, ground.along
    boxes = [shapely.box(*box.lower[:2], *box.upper[:2]) for box in spec.boxes]
    free = shapely.box(x0, y0, x1, y1)
    if not any(shapely.intersects(free, box) for box in boxes):
        pieces = [np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)]
    else:
        free = shapely.difference(free, shapely.union_all(boxes))
        pieces = [
            piece
            for polygon in shapely.get_parts(free)
            if polygon.geom_type == "Polygon"
            for piece in decompose_convex(polygon)
        ]
    for number, piece in enumerate(pieces, start=1):
        name = GROUND_NAME if len(pieces) == 1 else f"{GROUND_NAME} {number}"
        outline = tuple((float(x), float(y)) for x, y in piece)
        plane = RegionPlane(outline, (0.0, 0.0), (*outline[0], ground.height))
        yield TerrainRegion(name, plane, ground.friction)


def _pad_outline(outline: Array, count: int) -> Array:
    """Return `count` corners (count, 2) with the last one repeated; none if count is 0."""
    return outline[np.minimum(np.arange(count), len(outline) - 1)]
