"""Contact regions of a scan: convex, flat, near the raw surface, away from edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from climbplan.arrays import Array, IntArray
from climbplan.scan.cleaning import areas
from climbplan.scan.convex import convex_pieces, crossed, peeled
from climbplan.scan.growing import grown
from climbplan.scan.panels import HEADROOM, Frame, standable
from climbplan.scan.raw import RawScan
from climbplan.scan.triangles import buried
from climbplan.schema.terrain.scan import ScanSpec

_DEPTH = 2.0  # [m] of material through which its other side is looked for
_SAME_NORMAL, _SAME_PLANE = 1e-5, 1e-5  # [m] patches this alike are one
_PLAIN = 24  # corners up to which a polygon is taken as it is
_OWN = 0.3  # share of a piece that no other patch may hold
_SHARE = 0.08  # of a patch that is new: with less it does not overlap others
_GAP = 0.05  # the same share of its largest piece: less is a gap between others
_PEELS = 4  # pieces of a patch that others overlap
_SMOOTH = 0.4  # of the flatness: how far jagged borders are drawn in


@dataclass(frozen=True)
class FoundRegion:
    """A convex flat piece of a scan on which toes may stand."""

    vertices: Array  # (K, 3) anticlockwise seen from free space [m]
    normal: Array  # (3,) unit, into free space
    label: str  # material or colour in the file
    area: float  # [m^2]

    @property
    def middle(self) -> Array:
        """Mean of its corners (3,)."""
        return np.asarray(self.vertices.mean(axis=0))


def found_regions(raw: RawScan, spec: ScanSpec) -> tuple[FoundRegion, ...]:
    """All contact regions of a scan, largest first."""
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = doubled / np.linalg.norm(doubled, axis=1, keepdims=True)
    found: list[FoundRegion] = []
    for plane in _planes(raw, corners, spec):
        frame = Frame.on(plane.normal, plane.offset)
        free = standable(frame, plane.own, corners, normals, spec.flatness, spec.toe_radius)
        overlaps = len(plane.first) < len(plane.own)
        pieces = [
            piece
            for polygon in _polygons(free, spec)
            for piece in _pieces(polygon, overlaps, spec.min_size)
        ]
        label = raw.labels[int(raw.label[plane.own[0]])]
        for piece in _new(pieces, frame, plane, corners):
            region = _region(frame, piece, label, spec)
            if region is not None:
                found.append(region)
    if not found:
        return ()
    middles, directions = (
        np.array([getattr(r, name) for r in found]) for name in ("middle", "normal")
    )
    hidden = buried(middles + (HEADROOM / 2) * directions, directions, corners, _DEPTH)
    seen = [r for r, inside in zip(found, hidden, strict=True) if not inside]
    return tuple(sorted(seen, key=lambda r: (-round(r.area, 9), *np.round(r.middle, 9))))


@dataclass(frozen=True)
class _Plane:
    """A patch, or several in one plane."""

    own: IntArray  # triangles
    first: IntArray  # of these the ones that no patch before it has
    normal: Array
    offset: float


def _planes(raw: RawScan, corners: Array, spec: ScanSpec) -> list[_Plane]:
    """Every patch that may hold a region; those in one plane are one."""
    patches = grown(raw, spec.flatness)
    alike: dict[tuple[int, ...], list[int]] = {}
    for p, (normal, offset) in enumerate(zip(patches.normal, patches.offset, strict=True)):
        label = int(raw.label[patches.of(p)[0]])
        key = (*np.round(normal / _SAME_NORMAL).astype(int), round(offset / _SAME_PLANE))
        alike.setdefault((*key, label), []).append(p)
    size = areas(raw)
    out = []
    for numbers in alike.values():
        normal, offset = patches.normal[numbers[0]], float(patches.offset[numbers[0]])
        own = np.unique(np.concatenate([patches.of(p) for p in numbers]))
        groups = [(numbers, own)]
        if np.abs(corners[own] @ normal - offset).max() > spec.flatness + 1e-9:
            groups = [([p], patches.of(p)) for p in numbers]
        for group, triangles in groups:
            first = triangles[np.isin(patches.owner[triangles], group)]
            if size[first].sum() < _SHARE * size[triangles].sum():
                triangles = first  # what others left over between them
            normal, offset = patches.normal[group[0]], float(patches.offset[group[0]])
            out.append(_Plane(triangles, first, normal, offset))
    least = max(spec.min_size, 1e-4)
    flattest = np.cos(np.deg2rad(spec.steepest_deg)) - 1e-9
    out = [plane for plane in out if plane.normal[2] >= flattest]
    return [plane for plane in out if _width_bound(corners[plane.own]) >= least]


def _width_bound(corners: Array) -> float:
    """The second largest extent of points along their own axes: no region is wider."""
    points = corners.reshape(-1, 3)
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1]
    return float(np.sort(np.ptp(centred @ axes, axis=0))[1])


def _pieces(polygon: shapely.Polygon, overlaps: bool, least_size: float) -> list[Array]:
    """Convex pieces: of a patch that others overlap few large ones, else all of it."""
    if overlaps:
        return peeled(polygon, _PEELS, least_size**2)
    return convex_pieces(polygon)


def _new(pieces: list[Array], frame: Frame, plane: _Plane, corners: Array) -> list[Array]:
    """Pieces that are not mostly on what other patches hold."""
    if len(plane.first) == len(plane.own) or not pieces:
        return pieces
    middles = shapely.points(frame.own(corners[plane.first].mean(axis=1))[:, :2])
    edges = np.diff(corners[plane.first], axis=1)
    weights = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    polygons = shapely.polygons([shapely.linearrings(piece) for piece in pieces])
    size = shapely.area(polygons)
    tree = shapely.STRtree(middles)
    piece, point = tree.query(polygons, predicate="contains")
    own = np.bincount(piece, weights=weights[point] / 2, minlength=len(pieces))
    keep = own >= _OWN * size
    largest = int(np.argmax(size))
    keep[largest] = own[largest] >= _GAP * size[largest]
    return [piece for piece, kept in zip(pieces, keep, strict=True) if kept]


def _polygons(free: shapely.Geometry, spec: ScanSpec) -> list[shapely.Polygon]:
    """Polygons of an area, without borders more jagged than the scan is sharp."""
    out = []
    for part in shapely.get_parts(free):
        if part.geom_type != "Polygon" or part.area <= spec.min_size**2 * 0.5:
            continue
        if shapely.get_num_coordinates(part) <= _PLAIN:
            out.append(part)
            continue
        by = _SMOOTH * spec.flatness
        inner = part.buffer(-by, join_style="mitre").simplify(by)
        inner = shapely.intersection(inner, part)
        out += [p for p in shapely.get_parts(inner) if p.geom_type == "Polygon" and p.area > 0]
    return out


def _region(frame: Frame, piece: Array, label: str, spec: ScanSpec) -> FoundRegion | None:
    """A piece as a region, unless it is too small."""
    if len(piece) < 3 or _width(piece) < max(spec.min_size, 1e-4):
        return None
    spokes = piece - piece[0]
    area = float(crossed(spokes[1:-1], spokes[2:]).sum() / 2)
    return FoundRegion(frame.world(piece), frame.normal, label, area)


def _width(piece: Array) -> float:
    """Smallest width of a convex polygon (K, 2), across one of its edges."""
    edges = np.roll(piece, -1, axis=0) - piece
    lengths = np.linalg.norm(edges, axis=1)
    sound = lengths > 1e-12
    out = np.column_stack([edges[:, 1], -edges[:, 0]])[sound] / lengths[sound, None]
    heights = out @ piece.T
    return float((heights.max(axis=1) - heights.min(axis=1)).min())
