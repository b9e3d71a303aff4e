"""Clearance between the robot and the triangles of a scan, as planning measures it.

`climbplan/terrain/raw_surface.py` states the required clearance; the checks measure it
independently (`climbplan/climb/check/scan.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.robots.capsules import Capsules
from climbplan.terrain.raw_surface import FACING, NARROW, RISING, SLENDER, RawSurface
from climbplan.terrain.solids import Solid

THE_SCAN = "the scan"
_SLAB_DEPTH = 0.05  # [m] of material behind a triangle
_CONVEXITY_TOLERANCE = 1e-4  # [m] by which corners may stick out of a convex body
_MIN_THICKNESS = 1e-3  # [m] of a body
_SAME_PLANE = 1 - 1e-6  # cosine
_TOE_ZONE = 3e-3  # [m] beyond the flatness, twice: the last of a limb, which may touch
_DISTANCE_TOLERANCE = 1e-9  # [m] of missing room that counts
_NUM_PIECES = (
    5  # of the narrowed end of a limb, and as many of what its contact's surface may be near
)


@dataclass(frozen=True)
class ToeContacts:
    """Present, or past and next, contacts of toes: C of each limb of each pose (..., C, 3)."""

    places: Array  # [m]; NaN for none
    normals: Array  # unit, into free space


@dataclass(frozen=True)
class NearestRaw:
    """The link with the largest clearance shortfall from the scan, and the solids concerned."""

    missing: float  # [m] of the room that it has to keep there, zero where all is kept
    index: tuple[int, ...]  # of limb and pose
    link: int
    radius: float  # [m]
    solids: tuple[Solid, ...]  # what is behind the triangles that links come too close to


def find_nearest_raw(
    scan: RawSurface, capsules: Capsules, contacts: ToeContacts, margin: float
) -> NearestRaw:
    """Find the largest clearance shortfall of links from the triangles of a scan.

    Args:
        scan: The scan.
        capsules: (..., C) links; limbs with NaN are left out.
        contacts: (..., C, 3) contacts of each limb, whose surfaces its tapered end may approach.
        margin: Clearance beyond the radius [m].
    """
    measured = _measure_shortfalls(scan, capsules, contacts, margin)
    missing = measured.missing
    worst = int(np.argmax(missing))
    shape = capsules.starts.shape[:-2]
    index = tuple(int(i) for i in np.unravel_index(int(measured.limb[worst]), shape))
    hit = measured.triangle[(missing > _DISTANCE_TOLERANCE) & (measured.triangle >= 0)]
    solids = _build_solids_behind(scan, np.unique(hit))
    worst_link = index[-1], int(measured.link[worst])
    return NearestRaw(
        float(missing[worst]),
        index,
        int(capsules.link[worst_link]),
        float(capsules.radius[worst_link]),
        solids,
    )


def compute_raw_shortfalls(
    scan: RawSurface, capsules: Capsules, contacts: ToeContacts, margin: float
) -> Array:
    """Compute the largest clearance shortfall (...) of each limb's links [m].

    Arguments as of `find_nearest_raw`; zero where all room is kept.
    """
    measured = _measure_shortfalls(scan, capsules, contacts, margin)
    shape = capsules.starts.shape[:-2]
    shortfalls = np.zeros(int(np.prod(shape)))
    np.maximum.at(shortfalls, measured.limb, measured.missing)
    return shortfalls.reshape(shape)


@dataclass(frozen=True)
class _Shortfalls:
    """Missing room of pieces of links."""

    missing: Array  # (Q,) [m]
    limb: IntArray  # (Q,) of all poses, flat
    link: IntArray  # (Q,)
    triangle: IntArray  # (Q,) of the scan, -1 for none


def _measure_shortfalls(
    scan: RawSurface, capsules: Capsules, contacts: ToeContacts, margin: float
) -> _Shortfalls:
    """Measure the room that pieces of links lack, and the triangles that are too near."""
    from climbplan.scan.distances import compute_missing_clearance, find_contact_surfaces

    shape, count = capsules.starts.shape[:-2], capsules.starts.shape[-2]
    starts, ends = (v.reshape(-1, count, 3) for v in (capsules.starts, capsules.ends))
    radius, to_toe = (
        np.broadcast_to(v, (*shape, count)).reshape(-1, count)
        for v in (capsules.radius, capsules.to_toe)
    )  # (B, L) of B limbs with L capsules
    unique, contact_index = _index_contacts(contacts, shape)
    reach = float(capsules.radius.max()) + margin
    number = _find_near_triangles(scan, np.stack([capsules.starts, capsules.ends]), reach)
    corners = np.ascontiguousarray(scan.corners[number])
    places, normals = (np.ascontiguousarray(v) for v in np.split(np.nan_to_num(unique), 2, axis=1))
    surfaces = find_contact_surfaces(places, normals, corners, FACING, RISING, scan.flatness)

    limb, link = np.nonzero(np.isinf(to_toe))  # those that end far from toes, as a whole
    required_distance = np.broadcast_to(
        (radius[limb, link] + margin)[:, None], (len(limb), 1 + contact_index.shape[1])
    )
    last_limb, last = np.nonzero(np.isfinite(to_toe))
    last_links = _LastLinks(*(v[last_limb, last] for v in (starts, ends, to_toe, radius)))
    end = _taper_limb_end(scan, last_links, unique[:, :3], contact_index[last_limb], margin)
    pieces = end.starts.shape[1]
    limb = np.concatenate([limb, np.repeat(last_limb, pieces)])
    link = np.concatenate([link, np.repeat(last, pieces)])
    whole = np.isinf(to_toe)
    missing, triangle = compute_missing_clearance(
        np.concatenate([starts[whole], end.starts.reshape(-1, 3)]),
        np.concatenate([ends[whole], end.ends.reshape(-1, 3)]),
        np.concatenate([required_distance, end.required.reshape(-1, required_distance.shape[1])]),
        contact_index[limb],
        surfaces,
        corners,
        reach,
    )
    # A limb out of reach is left out as a whole
    unknown = np.asarray(np.isnan(starts).any(axis=(1, 2)))
    missing = np.where(unknown[limb], 0.0, missing)
    closest = np.where(triangle >= 0, number[triangle], -1) if len(number) else triangle
    return _Shortfalls(missing, limb, link, closest)


def _index_contacts(contacts: ToeContacts, shape: tuple[int, ...]) -> tuple[Array, IntArray]:
    """Return the different contacts (U, 6), place and normal, and which ones (B, C) each of B limbs
    of a shape has, -1 for none."""
    places = np.broadcast_to(contacts.places, (*shape, *contacts.places.shape[-2:]))
    normals = np.broadcast_to(contacts.normals, places.shape)
    each = np.concatenate([places, normals], axis=-1).reshape(-1, 6)
    unique, contact_index = np.unique(each, axis=0, return_inverse=True)  # NaN are alike
    contact_index = contact_index.reshape(math.prod(shape), -1).astype(np.int64)
    return unique, np.where(np.isnan(unique[contact_index, 0]), -1, contact_index)


class _LastLinks(NamedTuple):
    """Capsules of B last links."""

    starts: Array  # (B, 3) [m]
    ends: Array  # (B, 3) [m]
    to_toe: Array  # (B,) from the end to the toe, along the axis [m]
    radius: Array  # (B,) [m]


@dataclass(frozen=True)
class _TaperedEnd:
    """B capsules of last links in Q pieces, from the knee on, with their required clearance."""

    starts: Array  # (B, Q, 3)
    ends: Array  # (B, Q, 3)
    required: (
        Array  # (B, Q, 1 + C) [m], from all surfaces and from those of contacts; negative: none
    )


def _taper_limb_end(
    scan: RawSurface,
    links: _LastLinks,
    places: Array,
    contact_index: IntArray,
    margin: float,
) -> _TaperedEnd:
    """Cut last links into what narrows to the toe, or is near the surface on which the toe stands.

    places: (U, 3) of contacts; contact_index: (B, C) contacts of each link, -1 for none.
    """
    starts, ends, to_toe, radius = links
    touching = 2 * scan.flatness + _TOE_ZONE
    taper_length = np.maximum((radius + scan.flatness) / SLENDER, NARROW)
    near_distances = np.concatenate([np.linspace(NARROW, touching, _NUM_PIECES + 1), [0.0]])
    distances = np.concatenate(
        [
            np.full((1, len(starts)), np.inf),
            np.linspace(taper_length, np.full_like(taper_length, NARROW), _NUM_PIECES + 1)[:-1],
            np.broadcast_to(near_distances[:, None], (len(near_distances), len(starts))),
        ]
    ).T  # (B, Q + 1) [m] way to the toe
    axis = starts - ends
    length = np.linalg.norm(axis, axis=1)
    axial_distance = distances - to_toe[:, None]
    fraction = np.clip(axial_distance / np.maximum(length, 1e-9)[:, None], 0.0, 1.0)
    cuts = ends[:, None] + fraction[..., None] * axis[:, None]  # (B, Q + 1, 3)
    full_distance = (radius + margin)[:, None]
    required = np.empty((len(starts), distances.shape[1] - 1, 1 + contact_index.shape[1]))
    required[..., 0] = np.where(distances[:, :-1] > NARROW + 1e-9, full_distance, margin)
    for c in range(contact_index.shape[1]):
        # The room asked grows with the distance, which is largest at an end of a piece
        contact_distance = np.linalg.norm(cuts - places[contact_index[:, c], None], axis=-1)
        contact_distance = np.maximum(contact_distance[:, :-1], contact_distance[:, 1:])
        cone = SLENDER * contact_distance - scan.flatness
        required_there = np.where(cone > 0, np.minimum(cone + margin, full_distance), -1.0)
        required[..., 1 + c] = np.where(
            contact_index[:, c, None] < 0, full_distance, required_there
        )
        required[
            contact_distance[:, -1] <= touching + 1e-9, -1, 0
        ] = -1.0  # the tip, where it stands
    required[:, 0] = full_distance  # from the knee to where it is far from what it stands on
    is_empty = (axial_distance[:, :-1] < 0) | (
        axial_distance[:, 1:] > length[:, None]
    )  # the axis has no such part
    required[is_empty] = -1.0
    return _TaperedEnd(cuts[:, :-1], cuts[:, 1:], required)


def _build_solids_behind(scan: RawSurface, triangles: IntArray) -> tuple[Solid, ...]:
    """Build the material behind some triangles: whole convex bodies, or slabs behind planes."""
    if not len(triangles):
        return ()
    corners = scan.corners
    cross_products = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = cross_products / np.linalg.norm(cross_products, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    solids: dict[str, Solid] = {}
    for t in (int(t) for t in triangles):
        piece = _find_connected(scan, np.arange(len(corners), dtype=np.int64), t)
        places = corners[piece].reshape(-1, 3)
        heights = normals[piece] @ places.T - offsets[piece, None]
        if heights.max() > _CONVEXITY_TOLERANCE or heights.min() > -_MIN_THICKNESS:
            # Not a convex body: a slab behind what lies in the triangle's plane
            is_coplanar = (normals @ normals[t] > _SAME_PLANE) & (
                np.abs(offsets - offsets[t]) < _CONVEXITY_TOLERANCE
            )
            places = corners[
                _find_connected(scan, np.asarray(np.flatnonzero(is_coplanar), np.int64), t)
            ].reshape(-1, 3)
            front = places - ((places @ normals[t]) - offsets[t])[:, None] * normals[t]
            places = np.concatenate([front, front - _SLAB_DEPTH * normals[t]])
        middle = ", ".join(f"{v:.2f}" for v in places.mean(axis=0))
        name = f"{THE_SCAN} about {middle}"
        try:
            solids[name] = Solid.from_points(name, places)
        except UsageError:
            continue  # a sliver, which has no material behind it
    return tuple(solids.values())


def _find_connected(scan: RawSurface, candidates: IntArray, first: int) -> IntArray:
    """Find the candidates that are connected with one of them by common corners."""
    connected = {first}
    reached = set(scan.triangles[first].tolist())
    remaining = [t for t in candidates.tolist() if t != first]
    while True:
        neighbours = [t for t in remaining if reached & set(scan.triangles[t].tolist())]
        if not neighbours:
            return np.array(sorted(connected), np.int64)
        connected |= set(neighbours)
        remaining = [t for t in remaining if t not in connected]
        reached |= set(scan.triangles[neighbours].ravel().tolist())


def is_path_clear(scan: RawSurface, path: Array, min_distance: float) -> bool:
    """Return whether a path (S, 3) keeps a minimum distance from all triangles [m]."""
    from climbplan.scan.distances import compute_triangle_distances

    corners = np.ascontiguousarray(scan.corners[_find_near_triangles(scan, path, min_distance)])
    starts, ends = (np.ascontiguousarray(v) for v in (path[:-1], path[1:]))
    return bool(
        (
            compute_triangle_distances(starts, ends, corners, min_distance) >= min_distance - 1e-9
        ).all()
    )


def compute_raw_body_distance(scan: RawSurface, hulls: Array, max_distance: float) -> Array:
    """Compute distances (...) of body hulls (..., V, 3) from triangles, up to a maximum [m].

    Corners and edges of the hull are compared with triangles, and triangles with the hull's faces;
    zero where they intersect.
    """
    from climbplan.scan.distances import compute_triangle_distances

    flat = hulls.reshape(-1, *hulls.shape[-2:])
    corners = np.ascontiguousarray(scan.corners[_find_near_triangles(scan, hulls, max_distance)])
    distances = np.full(len(flat), max_distance)
    if not len(corners):
        return distances.reshape(hulls.shape[:-2])
    first, last = np.triu_indices(hulls.shape[-2], k=1)
    centre = flat.mean(axis=1)
    size = np.linalg.norm(flat - centre[:, None], axis=-1).max(axis=1)
    center_distance = compute_triangle_distances(
        centre, centre, corners, float(size.max()) + max_distance
    )
    for p in np.flatnonzero(center_distance < size + max_distance):
        # All chords between corners: edges among them, and what passes through the hull
        distances[p] = compute_triangle_distances(
            flat[p, first], flat[p, last], corners, max_distance
        ).min()
        inside = (_compute_heights(flat[p], corners.reshape(-1, 3)) < max_distance).all(axis=-1)
        if inside.any():
            heights = _compute_heights(flat[p], corners.reshape(-1, 3)[inside]).max(axis=-1)
            distances[p] = min(distances[p], max(float(heights.min()), 0.0))
    return distances.reshape(hulls.shape[:-2])


def _compute_heights(hull: Array, points: Array) -> Array:
    """Compute heights (P, F) of points over the faces of a hull [m]."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(hull).equations
    return points @ planes[:, :3].T + planes[:, 3]


def _find_near_triangles(scan: RawSurface, points: Array, max_distance: float) -> IntArray:
    """Find triangles whose bounds come within a distance of the bounds of points [m]."""
    flat = points.reshape(-1, 3)
    low, high = np.nanmin(flat, axis=0) - max_distance, np.nanmax(flat, axis=0) + max_distance
    return scan.find_triangles_in(low, high)
