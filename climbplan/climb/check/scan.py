"""A plan against the raw surface of its scan, which the file carries: toes, links and body.

Contact regions are what planning made of a scan. Here they are not asked: toes are measured against
the triangles themselves, forces against the normals of these, links and body against all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.climb.check.anew.kinematics import body_axes, placed
from climbplan.climb.check.convex import hull_distance
from climbplan.climb.check.subject import Subject
from climbplan.climb.plan.climb_plan import Index
from climbplan.plans.check import Array, Check, judge_worst
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.surfaces import Region

_NARROW = 0.05  # [m] last part of a limb, which narrows to its toe
_AT_TOE = 2e-3  # [m] beyond the flatness, twice: the last of it, which may touch
_FACING = 0.5  # cosine to the region's normal of triangles that a toe stands on
_NO_DIRECTION = 1e-12  # [m] a difference shorter than this has no direction
_CHUNK = 200_000  # pairs of segment and triangle at a time
_TOLD = 5e-3  # [m] room beside links up to which it is measured
_OWN = ("left", "right", "ground", "panel", "tube")  # surfaces that specs state by other keys


def scan_checks(subject: Subject) -> Iterator[Check]:
    """Toes, friction and body against the raw surface, and links at the instants."""
    scan = subject.plan.terrain.scan
    if scan is None:
        return
    yield _toes(subject, scan)
    yield _friction(subject, scan)
    yield _body(subject, scan)
    yield judge_scan_links("scan.limbs", subject, subject.limbs.points, subject.at)


def _standing(subject: Subject) -> tuple[Index, Index, Array]:
    """Instants, limbs (S,) and places (S, 3) of toes that stand on what was found in the scan."""
    plan = subject.plan
    scanned = np.array(
        [isinstance(s, Region) and s.name not in _OWN for s in plan.terrain.surfaces], bool
    )
    standoff = np.array([getattr(s, "standoff", 0.0) for s in plan.terrain.surfaces])
    region = plan.instants.region
    instant, limb = np.nonzero(plan.instants.contact & scanned[region])
    toes = plan.instants.toes - standoff[region][..., None] * plan.instants.normal
    return np.asarray(instant, np.int64), np.asarray(limb, np.int64), toes[instant, limb]


def _toes(subject: Subject, scan: RawSurface) -> Check:
    """Every standing toe lies within the flatness of the raw surface."""
    instant, limb, toes = _standing(subject)
    if not len(toes):
        return judge_worst("scan.toes", np.zeros(1), lambda _: "", margin="no toe on the scan")
    places, number = np.unique(toes, axis=0, return_inverse=True)
    away = _distances(places, places, scan.corners, scan.flatness + 0.1)[number.reshape(-1)]

    def where(row: int) -> str:
        return f"{subject.at(int(instant[row]))}, {subject.limb(int(limb[row]))}"

    margin = f"{1e3 * away.max():.2f} mm off, asked {1e3 * scan.flatness:.2f} mm"
    return judge_worst("scan.toes", away - scan.flatness, where, margin, away / scan.flatness)


def _friction(subject: Subject, scan: RawSurface) -> Check:
    """Forces lie within friction of the raw surface's own normal about each toe."""
    plan = subject.plan
    instant, limb, toes = _standing(subject)
    if not len(toes) or plan.robot.gripper is not None:
        margin = "held by grippers" if len(toes) else "no toe on the scan"
        return judge_worst("scan.friction", np.zeros(1), lambda _: "", margin=margin)
    planned = plan.instants.normal[instant, limb]
    normals = _normals(toes, planned, scan)
    force, mu = plan.forces.force[instant, limb], plan.instants.mu[instant, limb]
    pressing = (force * normals).sum(axis=1)
    sideways = np.linalg.norm(force - pressing[:, None] * normals, axis=1)
    over = (sideways - mu * pressing) / subject.weight
    turn = np.arccos(np.clip((normals * planned).sum(axis=1), -1, 1))

    def where(row: int) -> str:
        return f"{subject.at(int(instant[row]))}, {subject.limb(int(limb[row]))}"

    used = sideways / np.maximum(mu * pressing, 1e-9 * subject.weight)
    loaded = np.linalg.norm(force, axis=1) > 1e-6 * subject.weight
    used = np.where(loaded, used, 0.0)
    margin = (
        f"S_mu {1 / max(float(used.max()), 1e-9):.2f}, "
        f"raw normals off by up to {np.rad2deg(turn.max()):.1f} deg"
    )
    return judge_worst("scan.friction", over, where, margin, used)


def _normals(toes: Array, planned: Array, scan: RawSurface) -> Array:
    """Mean normals (S, 3) of the raw triangles about each toe that face as its region does."""
    corners = scan.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(doubled, axis=1)
    normals = doubled / np.maximum(size, 1e-15)[:, None]
    about = scan.toe_radius + scan.flatness
    disc = np.pi * about**2
    out = np.array(planned)
    for row, (toe, normal) in enumerate(zip(toes, planned, strict=True)):
        near = _meeting(corners, toe - about, toe + about)
        near = near[normals[near] @ normal > _FACING]
        ends = np.broadcast_to(toe, (len(near), 3))
        near = near[_gaps(ends, ends, corners[near]) <= about]
        if len(near):
            mean = np.minimum(size[near] / 2, disc) @ normals[near]
            out[row] = mean / np.linalg.norm(mean)
    return out


def _body(subject: Subject, scan: RawSurface) -> Check:
    """The hull at every instant and sample keeps its clearance from all triangles."""
    plan = subject.plan
    asked = plan.limits.body_clearance
    poses = np.vstack(
        [
            np.hstack([plan.instants.com, plan.instants.rpy]),
            np.hstack([plan.trajectory.com, plan.trajectory.rpy]),
        ]
    )
    moved = np.append(True, (np.diff(poses, axis=0) != 0).any(axis=1))
    rows = np.flatnonzero(moved)
    hulls = placed(poses[rows, :3], body_axes(poses[rows, 3:]), subject.body.corners)
    corners, wide = scan.corners, asked + _TOLD
    clear = np.full(len(rows), wide)
    for p, hull in enumerate(hulls):
        for t in _meeting(corners, hull.min(axis=0) - wide, hull.max(axis=0) + wide):
            clear[p] = min(clear[p], hull_distance(hull, corners[t]))

    def where(pose: int) -> str:
        row, count = int(rows[pose]), plan.instants.count
        return subject.at(row) if row < count else subject.at_time(row - count)

    least = float(clear.min())
    words = "at least " if least >= wide else ""
    margin = f"{words}{1e3 * least:.1f} mm, asked {1e3 * asked:.1f} mm"
    return judge_worst("scan.body", asked - clear, where, margin, asked / np.maximum(clear, 1e-9))


def judge_scan_links(
    name: str, subject: Subject, points: Array, moment: Callable[[int], str]
) -> Check:
    """A check that links, as thick as they are, miss the raw surface but at their toes.

    points: (P, N, J + 1, 3) joints and toes. The last 5 cm of a limb narrow to its toe: of these
    the axis alone has to miss it, up to where the surface may be by the scan's flatness.
    """
    scan = subject.plan.terrain.scan
    assert scan is not None
    radius = subject.plan.robot.limb_radius
    starts, ends = points[..., :-1, :], points[..., 1:, :].copy()
    tibia = points[..., -1, :] - points[..., -2, :]
    length = np.maximum(np.linalg.norm(tibia, axis=-1, keepdims=True), 1e-9)
    along = tibia / length
    narrow = points[..., -1, :] - along * np.minimum(_NARROW, length)
    ends[..., -1, :] = narrow
    at_toe = np.minimum(2 * scan.flatness + _AT_TOE, length)
    last = points[..., -1, :] - along * at_toe
    enough = radius + _TOLD
    clear = _distances(starts.reshape(-1, 3), ends.reshape(-1, 3), scan.corners, enough)
    clear = clear.reshape(starts.shape[:-1])
    axis = _distances(narrow.reshape(-1, 3), last.reshape(-1, 3), scan.corners, enough)
    axis = axis.reshape(narrow.shape[:-1]) + radius  # it has no thickness to keep
    clear[..., -1] = np.minimum(clear[..., -1], axis)

    def where(p: int, limb: int, link: int) -> str:
        return f"{moment(p)}, {subject.limb(limb, link)} and the scan"

    least = float(clear.min()) - radius
    words = f"at least {1e3 * least:.1f} mm clear"
    if not least >= 0:
        words = f"{-1e3 * least:.1f} mm too close"
    margin = f"links of radius {1e3 * radius:.0f} mm {words}"
    return judge_worst(name, radius - clear, where, margin, radius / np.maximum(clear, 1e-9))


def _meeting(corners: Array, lower: Array, upper: Array) -> Index:
    """Numbers of triangles whose bounds meet a box."""
    inside = (corners.min(axis=1) <= upper) & (corners.max(axis=1) >= lower)
    return np.asarray(np.flatnonzero(inside.all(axis=1)), np.int64)


def _distances(starts: Array, ends: Array, corners: Array, enough: float) -> Array:
    """Distances (S,) of segments (S, 3) from the nearest triangle, `enough` [m] at most.

    Negative or zero where a segment meets one. NaN stays.
    """
    low, high = np.minimum(starts, ends) - enough, np.maximum(starts, ends) + enough
    out = np.where(np.isfinite(low).all(axis=1), enough, np.nan)
    if not len(starts):
        return out
    with np.errstate(invalid="ignore"):
        some = _meeting(corners, np.nanmin(low, axis=0), np.nanmax(high, axis=0))
    least, most = corners[some].min(axis=1), corners[some].max(axis=1)
    step = max(1, 20 * _CHUNK // max(len(some), 1))
    for at in range(0, len(starts), step):
        part = slice(at, at + step)
        near = (least[None] <= high[part, None]).all(axis=-1)
        near &= (most[None] >= low[part, None]).all(axis=-1)
        row, triangle = np.nonzero(near)
        for first in range(0, len(row), _CHUNK):
            rows, chosen = row[first : first + _CHUNK] + at, triangle[first : first + _CHUNK]
            gaps = _gaps(starts[rows], ends[rows], corners[some[chosen]])
            np.minimum.at(out, rows, gaps)
    return out


def _gaps(first: Array, last: Array, corners: Array) -> Array:
    """The widest gap (S,) that a plane leaves between segments (S, 3) and triangles (S, 3, 3).

    One of the candidates is perpendicular to the shortest way between them: the triangle's face,
    an edge and the segment, an end and an edge, a corner and the segment. No value is too large.
    """
    along = (last - first)[:, None]
    edges = np.roll(corners, -1, axis=1) - corners
    face = np.cross(edges[:, :1], -edges[:, 2:])
    crossed = np.cross(along, edges)
    to_ends = [end[:, None] - _nearest(end[:, None], corners, edges) for end in (first, last)]
    to_corners = _nearest(corners, first[:, None], along) - corners
    differences = np.concatenate([face, -face, crossed, -crossed, *to_ends, to_corners], axis=1)
    length = np.sqrt((differences**2).sum(axis=-1))
    short = length < _NO_DIRECTION
    normals = differences / np.where(short, 1.0, length)[..., None]
    inner = np.einsum("sdk,sck->sdc", normals, corners).max(axis=-1)
    outer = np.minimum(*((normals * end[:, None]).sum(axis=-1) for end in (first, last)))
    gap: Array = np.where(short, -np.inf, outer - inner).max(axis=1)
    return gap


def _nearest(point: Array, start: Array, along: Array) -> Array:
    """Nearest points (..., 3) of segments to points, both broadcast."""
    square = np.maximum((along**2).sum(axis=-1), np.finfo(float).tiny)
    share = np.clip(((point - start) * along).sum(axis=-1) / square, 0.0, 1.0)
    return np.asarray(start + share[..., None] * along)
