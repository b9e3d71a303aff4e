"""Room between the robot and the raw surface of a scan, as planning measures it.

What limbs keep from it is stated in `climbplan/terrain/raw_surface.py`; the checks measure it
again, by other means (`climbplan/climb/check/scan.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.robots.capsules import Capsules
from climbplan.terrain.raw_surface import FACING, NARROW, RISING, SLENDER, RawSurface
from climbplan.terrain.solids import Solid

THE_SCAN = "the scan"
_DEPTH = 0.05  # [m] of material behind a triangle
_CONVEX = 1e-4  # [m] by which corners may stick out of a convex body
_THICK = 1e-3  # [m] of a body
_SAME_PLANE = 1 - 1e-6  # cosine
_AT_TOE = 3e-3  # [m] beyond the flatness, twice: the last of a limb, which may touch
_TOO_NEAR = 1e-9  # [m] of missing room that counts
_PIECES = 5  # of the narrowed end of a limb, and as many of what its contact's surface may be near


@dataclass(frozen=True)
class Contacts:
    """Where toes stand, or stood and will stand: C of each limb of each pose (..., C, 3)."""

    places: Array  # [m]; NaN for none
    normals: Array  # unit, into free space


@dataclass(frozen=True)
class NearestRaw:
    """The link that comes too close to the raw surface by most, and all it comes too close to."""

    missing: float  # [m] of the room that it has to keep there, zero where all is kept
    index: tuple[int, ...]  # of limb and pose
    link: int
    radius: float  # [m]
    solids: tuple[Solid, ...]  # what is behind the triangles that links come too close to


def find_nearest_raw(
    scan: RawSurface, capsules: Capsules, contacts: Contacts, beyond: float
) -> NearestRaw:
    """The room that links lack from raw triangles: their radius from all that counts, and more.

    beyond: [m] what planning keeps beyond the radius. contacts: (..., C, 3), those of each limb.
    Limbs with NaN are left out.
    """
    from climbplan.scan.distances import contact_surfaces, missing_room

    shape, count = capsules.starts.shape[:-2], capsules.starts.shape[-2]
    starts, ends = (v.reshape(-1, count, 3) for v in (capsules.starts, capsules.ends))
    radius, to_toe = (
        np.broadcast_to(v, (*shape, count)).reshape(-1, count)
        for v in (capsules.radius, capsules.to_toe)
    )  # (B, L) of B limbs with L capsules
    own_places = np.broadcast_to(contacts.places, (*shape, *contacts.places.shape[-2:]))
    own_normals = np.broadcast_to(contacts.normals, own_places.shape)
    each = np.concatenate([own_places, own_normals], axis=-1).reshape(-1, 6)
    unique, which = np.unique(each, axis=0, return_inverse=True)  # NaN are alike
    which = which.reshape(len(starts), -1).astype(np.int64)
    which = np.where(np.isnan(unique[which, 0]), -1, which)

    both_ends = np.stack([capsules.starts, capsules.ends])
    reach = float(capsules.radius.max()) + beyond
    number = _find_near_triangles(scan, both_ends, reach)
    corners = np.ascontiguousarray(scan.corners[number])
    places, normals = (np.ascontiguousarray(v) for v in np.split(np.nan_to_num(unique), 2, axis=1))
    own = contact_surfaces(places, normals, corners, FACING, RISING, scan.flatness)

    limb, link = np.nonzero(np.isinf(to_toe))  # those that end far from toes, as a whole
    room = np.broadcast_to((radius[limb, link] + beyond)[:, None], (len(limb), 1 + which.shape[1]))
    last_limb, last = np.nonzero(np.isfinite(to_toe))
    at = last_limb, last
    end = _end_of_limb(
        scan,
        starts[at],
        ends[at],
        to_toe[at],
        radius[at],
        unique[:, :3],
        which[last_limb],
        beyond,
    )
    pieces = end.starts.shape[1]
    limb = np.concatenate([limb, np.repeat(last_limb, pieces)])
    link = np.concatenate([link, np.repeat(last, pieces)])
    whole = np.isinf(to_toe)
    missing, triangle = missing_room(
        np.concatenate([starts[whole], end.starts.reshape(-1, 3)]),
        np.concatenate([ends[whole], end.ends.reshape(-1, 3)]),
        np.concatenate([room, end.need.reshape(-1, room.shape[1])]),
        which[limb],
        own,
        corners,
        reach,
    )
    # A limb out of reach is left out as a whole
    unknown = np.asarray(np.isnan(starts).any(axis=(1, 2)))
    missing = np.where(unknown[limb], 0.0, missing)
    worst = int(np.argmax(missing))
    index = tuple(int(i) for i in np.unravel_index(int(limb[worst]), shape))
    hit = triangle[(missing > _TOO_NEAR) & (triangle >= 0)]
    solids = _behind(scan, number[np.unique(hit)])
    which_one = index[-1], int(link[worst])
    return NearestRaw(
        float(missing[worst]),
        index,
        int(capsules.link[which_one]),
        float(capsules.radius[which_one]),
        solids,
    )


@dataclass(frozen=True)
class _End:
    """B capsules of last links in Q pieces, from the knee on, and the room that they need."""

    starts: Array  # (B, Q, 3)
    ends: Array  # (B, Q, 3)
    need: Array  # (B, Q, 1 + C) [m], from all surfaces and from those of contacts; negative: none


def _end_of_limb(
    scan: RawSurface,
    starts: Array,
    ends: Array,
    to_toe: Array,
    radius: Array,
    places: Array,
    which: IntArray,
    beyond: float,
) -> _End:
    """A last link: what narrows to the toe, or is near the surface on which the toe stands.

    starts, ends: (B, 3), radius: (B,), and to_toe: (B,) from the end to the toe; places: (U, 3) of
    contacts; which: (B, C) contacts of each, -1 for none. Ways to the toe are along the axis.
    """
    touching = 2 * scan.flatness + _AT_TOE
    whole = np.maximum((radius + scan.flatness) / SLENDER, NARROW)
    near = np.concatenate([np.linspace(NARROW, touching, _PIECES + 1), [0.0]])
    far = np.concatenate(
        [
            np.full((1, len(starts)), np.inf),
            np.linspace(whole, np.full_like(whole, NARROW), _PIECES + 1)[:-1],
            np.broadcast_to(near[:, None], (len(near), len(starts))),
        ]
    ).T  # (B, Q + 1) [m] way to the toe
    along = starts - ends
    length = np.linalg.norm(along, axis=1)
    way = far - to_toe[:, None]
    share = np.clip(way / np.maximum(length, 1e-9)[:, None], 0.0, 1.0)
    cuts = ends[:, None] + share[..., None] * along[:, None]  # (B, Q + 1, 3)
    room = (radius + beyond)[:, None]
    need = np.empty((len(starts), far.shape[1] - 1, 1 + which.shape[1]))
    need[..., 0] = np.where(far[:, :-1] > NARROW + 1e-9, room, beyond)
    for c in range(which.shape[1]):
        # The room asked grows with the distance, which is largest at an end of a piece
        away = np.linalg.norm(cuts - places[which[:, c], None], axis=-1)
        away = np.maximum(away[:, :-1], away[:, 1:])
        cone = SLENDER * away - scan.flatness
        asked = np.where(cone > 0, np.minimum(cone + beyond, room), -1.0)
        need[..., 1 + c] = np.where(which[:, c, None] < 0, room, asked)
        need[away[:, -1] <= touching + 1e-9, -1, 0] = -1.0  # the tip, where it stands
    need[:, 0] = room  # from the knee to where it is far from what it stands on
    none = (way[:, :-1] < 0) | (way[:, 1:] > length[:, None])  # the axis has no such part
    need[none] = -1.0
    return _End(cuts[:, :-1], cuts[:, 1:], need)


def _behind(scan: RawSurface, triangles: IntArray) -> tuple[Solid, ...]:
    """The material behind some triangles: whole convex bodies, or slabs behind planes."""
    if not len(triangles):
        return ()
    corners = scan.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = doubled / np.linalg.norm(doubled, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    found: dict[str, Solid] = {}
    for t in (int(t) for t in triangles):
        piece = _touching(scan, np.arange(len(corners), dtype=np.int64), t)
        places = corners[piece].reshape(-1, 3)
        heights = normals[piece] @ places.T - offsets[piece, None]
        if heights.max() > _CONVEX or heights.min() > -_THICK:
            # Not a convex body: a slab behind what lies in the triangle's plane
            alike = (normals @ normals[t] > _SAME_PLANE) & (np.abs(offsets - offsets[t]) < _CONVEX)
            places = corners[
                _touching(scan, np.asarray(np.flatnonzero(alike), np.int64), t)
            ].reshape(-1, 3)
            front = places - ((places @ normals[t]) - offsets[t])[:, None] * normals[t]
            places = np.concatenate([front, front - _DEPTH * normals[t]])
        middle = ", ".join(f"{v:.2f}" for v in places.mean(axis=0))
        name = f"{THE_SCAN} about {middle}"
        try:
            found[name] = Solid.from_points(name, places)
        except UsageError:
            continue  # a sliver, which has no material behind it
    return tuple(found.values())


def _touching(scan: RawSurface, candidates: IntArray, first: int) -> IntArray:
    """Those of the candidates that are connected with one of them over common corners."""
    own = {first}
    reached = set(scan.triangles[first].tolist())
    left = [t for t in candidates.tolist() if t != first]
    while True:
        more = [t for t in left if reached & set(scan.triangles[t].tolist())]
        if not more:
            return np.array(sorted(own), np.int64)
        own |= set(more)
        left = [t for t in left if t not in own]
        reached |= set(scan.triangles[more].ravel().tolist())


def raw_toes_clear(scan: RawSurface, path: Array, room: float) -> bool:
    """Whether a way (S, 3) keeps `room` [m] from all raw triangles."""
    from climbplan.scan.distances import segment_distances

    corners = np.ascontiguousarray(scan.corners[_find_near_triangles(scan, path, room)])
    starts, ends = (np.ascontiguousarray(v) for v in (path[:-1], path[1:]))
    return bool((segment_distances(starts, ends, corners, room) >= room - 1e-9).all())


def compute_raw_body_distance(scan: RawSurface, hulls: Array, room: float) -> Array:
    """Distances (...) of body hulls (..., V, 3) from raw triangles, `room` [m] at most.

    Corners and edges of the hull against triangles, and these against the hull's faces: zero where
    they meet.
    """
    from climbplan.scan.distances import segment_distances

    flat = hulls.reshape(-1, *hulls.shape[-2:])
    corners = np.ascontiguousarray(scan.corners[_find_near_triangles(scan, hulls, room)])
    out = np.full(len(flat), room)
    if not len(corners):
        return out.reshape(hulls.shape[:-2])
    first, last = np.triu_indices(hulls.shape[-2], k=1)
    centre = flat.mean(axis=1)
    size = np.linalg.norm(flat - centre[:, None], axis=-1).max(axis=1)
    away = segment_distances(centre, centre, corners, float(size.max()) + room)
    for p in np.flatnonzero(away < size + room):
        # All chords between corners: edges among them, and what passes through the hull
        out[p] = segment_distances(flat[p, first], flat[p, last], corners, room).min()
        inside = (_heights(flat[p], corners.reshape(-1, 3)) < room).all(axis=-1)
        if inside.any():
            heights = _heights(flat[p], corners.reshape(-1, 3)[inside]).max(axis=-1)
            out[p] = min(out[p], max(float(heights.min()), 0.0))
    return out.reshape(hulls.shape[:-2])


def _heights(hull: Array, points: Array) -> Array:
    """(P, F) heights of points over the faces of a hull."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(hull).equations
    return points @ planes[:, :3].T + planes[:, 3]


def _find_near_triangles(scan: RawSurface, points: Array, room: float) -> IntArray:
    """Numbers of triangles whose bounds come within `room` [m] of the bounds of points."""
    flat = points.reshape(-1, 3)
    low, high = np.nanmin(flat, axis=0) - room, np.nanmax(flat, axis=0) + room
    corners = scan.corners
    inside = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    return np.asarray(np.flatnonzero(inside.all(axis=1)), np.int64)
