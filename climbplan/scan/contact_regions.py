"""Contact regions of a scan: convex, flat, near the raw surface, away from edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from climbplan.arrays import Array, IntArray
from climbplan.scan.cleaning import compute_areas
from climbplan.scan.convex import compute_cross, decompose_convex, extract_convex_pieces
from climbplan.scan.raw import RawScan
from climbplan.scan.region_growing import segment_planar_patches
from climbplan.scan.steppable_regions import (
    HEADROOM,
    PlaneFrame,
    ToeClearance,
    compute_steppable_area,
)
from climbplan.scan.triangles import find_buried
from climbplan.schema.terrain.scan import ScanSpec

_DEPTH = 2.0  # [m] of material through which rays are cast to its other side
_SAME_NORMAL, _SAME_PLANE = 1e-5, 1e-5  # [m] tolerances of patches in one plane
_MAX_PLAIN_CORNERS = 24  # of a polygon that is not simplified
_MIN_NEW_RATIO = 0.3  # of a piece, not covered by other patches
_MIN_OVERLAP_RATIO = 0.08  # of a patch that is new: with less it does not overlap others
_MIN_LARGEST_RATIO = 0.05  # new fraction of the largest piece: less is a gap between others
_MAX_PIECES = 4  # of a patch that others overlap
_BORDER_RATIO = 0.4  # over the flatness, by which jagged borders are shrunk


@dataclass(frozen=True)
class FoundRegion:
    """A convex flat piece of a scan on which toes may stand."""

    vertices: Array  # (K, 3) anticlockwise seen from free space [m]
    normal: Array  # (3,) unit, into free space
    label: str  # material or colour in the file
    area: float  # [m^2]

    @property
    def middle(self) -> Array:
        """The mean of its corners (3,)."""
        return np.asarray(self.vertices.mean(axis=0))


def find_contact_regions(
    raw: RawScan, spec: ScanSpec, foot_radius: float = 0.0
) -> tuple[FoundRegion, ...]:
    """Find all contact regions of a scan, largest first.

    Args:
        raw: The scan.
        spec: What counts as a region.
        foot_radius: Of spherical feet [m], which meet nothing beside where they stand; 0 for toes
            that are points.
    """
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = doubled / np.linalg.norm(doubled, axis=1, keepdims=True)
    required = ToeClearance(spec.flatness, spec.toe_radius, foot_radius)
    regions: list[FoundRegion] = []
    for plane in _merge_coplanar_patches(raw, corners, spec):
        frame = PlaneFrame.on(plane.normal, plane.offset)
        free = compute_steppable_area(frame, plane.triangles, corners, normals, required)
        overlaps = len(plane.first) < len(plane.triangles)
        pieces = [
            piece
            for polygon in _smooth_polygons(free, spec)
            for piece in _decompose(polygon, overlaps, spec.min_size)
        ]
        label = raw.labels[int(raw.label[plane.triangles[0]])]
        for piece in _select_new_pieces(pieces, frame, plane, corners):
            region = _build_region(frame, piece, label, spec)
            if region is not None:
                regions.append(region)
    if not regions:
        return ()
    middles, directions = (
        np.array([getattr(r, name) for r in regions]) for name in ("middle", "normal")
    )
    is_buried = find_buried(middles + (HEADROOM / 2) * directions, directions, corners, _DEPTH)
    visible = [r for r, is_hidden in zip(regions, is_buried, strict=True) if not is_hidden]
    return tuple(sorted(visible, key=lambda r: (-round(r.area, 9), *np.round(r.middle, 9))))


@dataclass(frozen=True)
class _Plane:
    """A patch, or several in one plane."""

    triangles: IntArray
    first: IntArray  # those that no patch before it has
    normal: Array
    offset: float


def _merge_coplanar_patches(raw: RawScan, corners: Array, spec: ScanSpec) -> list[_Plane]:
    """Return every patch that may contain a region; those in one plane are one."""
    patches = segment_planar_patches(raw, spec.flatness)
    coplanar: dict[tuple[int, ...], list[int]] = {}
    for p, (normal, offset) in enumerate(zip(patches.normal, patches.offset, strict=True)):
        label = int(raw.label[patches.of(p)[0]])
        key = (*np.round(normal / _SAME_NORMAL).astype(int), round(offset / _SAME_PLANE))
        coplanar.setdefault((*key, label), []).append(p)
    size = compute_areas(raw)
    planes = []
    for numbers in coplanar.values():
        normal, offset = patches.normal[numbers[0]], float(patches.offset[numbers[0]])
        triangles_of_all = np.unique(np.concatenate([patches.of(p) for p in numbers]))
        groups = [(numbers, triangles_of_all)]
        if np.abs(corners[triangles_of_all] @ normal - offset).max() > spec.flatness + 1e-9:
            groups = [([p], patches.of(p)) for p in numbers]
        for group, triangles in groups:
            first = triangles[np.isin(patches.owner[triangles], group)]
            if size[first].sum() < _MIN_OVERLAP_RATIO * size[triangles].sum():
                triangles = first  # what others left over between them
            normal, offset = patches.normal[group[0]], float(patches.offset[group[0]])
            planes.append(_Plane(triangles, first, normal, offset))
    min_width = max(spec.min_size, 1e-4)
    flattest = np.cos(np.deg2rad(spec.steepest_deg)) - 1e-9
    planes = [plane for plane in planes if plane.normal[2] >= flattest]
    return [plane for plane in planes if _bound_width(corners[plane.triangles]) >= min_width]


def _bound_width(corners: Array) -> float:
    """Return the second largest extent of points along their principal axes: no region is wider."""
    points = corners.reshape(-1, 3)
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1]
    return float(np.sort(np.ptp(centred @ axes, axis=0))[1])


def _decompose(polygon: shapely.Polygon, overlaps: bool, min_size: float) -> list[Array]:
    """Return convex pieces: all of a polygon, or few large ones if other patches overlap it."""
    if overlaps:
        return extract_convex_pieces(polygon, _MAX_PIECES, min_size**2)
    return decompose_convex(polygon)


def _select_new_pieces(
    pieces: list[Array], frame: PlaneFrame, plane: _Plane, corners: Array
) -> list[Array]:
    """Return the pieces that other patches do not mostly cover."""
    if len(plane.first) == len(plane.triangles) or not pieces:
        return pieces
    middles = shapely.points(frame.to_local(corners[plane.first].mean(axis=1))[:, :2])
    edges = np.diff(corners[plane.first], axis=1)
    weights = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    polygons = shapely.polygons([shapely.linearrings(piece) for piece in pieces])
    size = shapely.area(polygons)
    tree = shapely.STRtree(middles)
    piece, point = tree.query(polygons, predicate="contains")
    new_area = np.bincount(piece, weights=weights[point] / 2, minlength=len(pieces))
    keep = new_area >= _MIN_NEW_RATIO * size
    largest = int(np.argmax(size))
    keep[largest] = new_area[largest] >= _MIN_LARGEST_RATIO * size[largest]
    return [piece for piece, is_kept in zip(pieces, keep, strict=True) if is_kept]


def _smooth_polygons(free: shapely.Geometry, spec: ScanSpec) -> list[shapely.Polygon]:
    """Return the polygons of an area, with borders no more jagged than the scan is accurate."""
    polygons = []
    for polygon in shapely.get_parts(free):
        if polygon.geom_type != "Polygon" or polygon.area <= spec.min_size**2 * 0.5:
            continue
        if shapely.get_num_coordinates(polygon) <= _MAX_PLAIN_CORNERS:
            polygons.append(polygon)
            continue
        shrink = _BORDER_RATIO * spec.flatness
        inner = polygon.buffer(-shrink, join_style="mitre").simplify(shrink)
        inner = shapely.intersection(inner, polygon)
        polygons += [p for p in shapely.get_parts(inner) if p.geom_type == "Polygon" and p.area > 0]
    return polygons


def _build_region(
    frame: PlaneFrame, piece: Array, label: str, spec: ScanSpec
) -> FoundRegion | None:
    """Return a piece as a region, None if it is too small."""
    if len(piece) < 3 or _compute_width(piece) < max(spec.min_size, 1e-4):
        return None
    spokes = piece - piece[0]
    area = float(compute_cross(spokes[1:-1], spokes[2:]).sum() / 2)
    return FoundRegion(frame.world(piece), frame.normal, label, area)


def _compute_width(piece: Array) -> float:
    """Return the smallest width of a convex polygon (K, 2), across one of its edges."""
    edges = np.roll(piece, -1, axis=0) - piece
    lengths = np.linalg.norm(edges, axis=1)
    sound = lengths > 1e-12
    outward = np.column_stack([edges[:, 1], -edges[:, 0]])[sound] / lengths[sound, None]
    heights = outward @ piece.T
    return float((heights.max(axis=1) - heights.min(axis=1)).min())
