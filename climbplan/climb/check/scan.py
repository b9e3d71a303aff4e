"""A plan against the raw surface of its scan, which the file carries: toes, links and body.

Contact regions are what planning made of a scan. Here they are not asked: toes are measured against
the triangles themselves, forces against the normals of these, links and body against all of them.
What limbs keep, and where, is stated in `climbplan/terrain/raw_surface.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.check.anew.capsules import Capsule
from climbplan.climb.check.anew.gait import gait_of
from climbplan.climb.check.anew.kinematics import body_axes, placed
from climbplan.climb.check.clearance import told_room
from climbplan.climb.check.convex import hull_distance
from climbplan.climb.check.subject import Subject
from climbplan.climb.plan.climb_plan import Index, Mask
from climbplan.plans.check import Array, Check, judge_worst
from climbplan.terrain.model import STATED
from climbplan.terrain.raw_surface import FACING, NARROW, RISING, SLENDER, RawSurface
from climbplan.terrain.surfaces import Region

_NARROWED, _SLENDER_PARTS = 4, 6  # pieces of a limb's last 5 cm, and beyond them
_AT_TOE = 2e-3  # [m] beyond the flatness, twice: the last of it, which may touch
_NO_DIRECTION = 1e-12  # [m] a difference shorter than this has no direction
_SOME = 2_000  # segments at a time
_CHUNK = 200_000  # pairs of segment and triangle at a time
_TOLD = 5e-3  # [m] room beside links up to which it is measured


def scan_checks(subject: Subject) -> Iterator[Check]:
    """Toes, friction and body against the raw surface, and links at the instants."""
    scan = subject.plan.terrain.scan
    if scan is None:
        return
    yield _toes(subject, scan)
    yield _friction(subject, scan)
    yield _body(subject, scan)
    stood = gait_of(subject.plan).stood
    contacts = contacts_on(subject, stood, np.zeros_like(stood) - 1)
    yield judge_scan_links("scan.limbs", subject, subject.capsules, contacts, subject.at)


def _standing(subject: Subject) -> tuple[Index, Index, Array]:
    """Instants, limbs (S,) and places (S, 3) of toes that stand on what was found in the scan."""
    plan = subject.plan
    scanned = np.array(
        [isinstance(s, Region) and s.name not in STATED for s in plan.terrain.surfaces], bool
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
    places, number = np.unique(np.hstack([toes, planned]), axis=0, return_inverse=True)
    normals = _normals(places[:, :3], places[:, 3:], scan)[number.reshape(-1)]
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
        near = near[normals[near] @ normal > FACING]
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


@dataclass(frozen=True)
class Contacts:
    """Where limbs stand, or have stood and will stand, for P poses and N limbs."""

    places: Array  # (P, N, 2, 3) [m]; NaN in the second where a limb is not on its way
    normals: Array  # (P, N, 2, 3) unit, into free space

    def at(self, poses: Index) -> Contacts:
        """Those of some poses."""
        return Contacts(self.places[poses], self.normals[poses])


def contacts_on(subject: Subject, stood: Index, next_one: Index) -> Contacts:
    """Contacts of limbs on, or from, the footholds of rounds (P, N), and to others; -1 for none."""
    rounds, surfaces = subject.plan.rounds, subject.plan.terrain.surfaces
    rows = np.stack([stood, next_one], axis=-1)
    limbs = np.arange(rows.shape[1])[:, None]
    places = rounds.toes[rows, limbs]
    places[rows < 0] = np.nan
    region = rounds.region[rows, limbs]
    normals = np.zeros_like(places)
    for index, surface in enumerate(surfaces):
        if isinstance(surface, Region):
            normals[region == index] = surface.normal
    return Contacts(places, normals)


def judge_scan_links(
    name: str,
    subject: Subject,
    capsules: Sequence[Capsule],
    contacts: Contacts,
    moment: Callable[[int], str],
) -> Check:
    """A check that links, as thick as they are, miss the raw surface but at their toes.

    `moment` describes a pose of the capsules.
    """
    scan = subject.plan.terrain.scan
    assert scan is not None
    columns = []
    for capsule in capsules:
        # While one limb swings the others stand still: what is alike is measured once
        first, back = _different(capsule, contacts)
        alone = replace(capsule, starts=capsule.starts[first], ends=capsule.ends[first])
        columns.append(_room(alone, contacts.at(first), scan)[back])
    clear = np.stack(columns, axis=1)  # (P, C)
    radii = np.array([capsule.radius for capsule in capsules])

    def where(p: int, number: int) -> str:
        capsule = capsules[number]
        return f"{moment(p)}, {subject.limb(capsule.limb, capsule.link)} and the scan"

    margin = told_room(clear - radii, radii)
    return judge_worst(name, radii - clear, where, margin, radii / np.maximum(clear, 1e-9))


def _different(capsule: Capsule, contacts: Contacts) -> tuple[Index, Index]:
    """Poses (K,) that differ in a capsule or its contacts, and which of them each is (P,)."""
    limb = capsule.limb
    stands = np.concatenate([contacts.places[:, limb], contacts.normals[:, limb]], axis=1)
    told = np.hstack([capsule.starts, capsule.ends, stands.reshape(len(stands), -1)])
    told = np.where(np.isnan(told), np.inf, told)  # as that all are alike
    _, first, back = np.unique(told, axis=0, return_index=True, return_inverse=True)
    # In the order of motion, in which neighbours are near each other
    order = np.argsort(first)
    place = np.empty(len(first), np.int64)
    place[order] = np.arange(len(first))
    return np.asarray(first[order], np.int64), place[back.reshape(-1)]


def _room(capsule: Capsule, contacts: Contacts, scan: RawSurface) -> Array:
    """Room (P,) beside the axis of a capsule, as if it had to keep its radius everywhere."""
    radius = capsule.radius
    starts, ends = capsule.starts, capsule.ends
    lacks = np.full(len(starts), -_TOLD)
    if np.isfinite(capsule.to_toe):
        whole = max((radius + scan.flatness) / SLENDER, NARROW)
        lacks = _end_lacks(capsule, contacts, scan)
        ends = _before_toe(capsule, np.array([whole]))[:, 0]
        if whole > capsule.to_toe + _length(capsule):
            return radius - lacks  # near the toe as a whole
    clear = _distances(starts, ends, scan.corners, radius + _TOLD)
    return np.minimum(clear, radius - lacks)


def _length(capsule: Capsule) -> float:
    """Of its axis [m], the same in all poses."""
    every = np.linalg.norm(capsule.starts - capsule.ends, axis=-1)
    return float(every.max(initial=0.0, where=np.isfinite(every)))


def _before_toe(capsule: Capsule, far: Array) -> Array:
    """Places (P, Q, 3) of a last link so far (Q,) along it from the toe, or at its ends."""
    along = capsule.starts - capsule.ends
    share = np.clip((far - capsule.to_toe) / max(_length(capsule), 1e-9), 0.0, 1.0)
    return np.asarray(capsule.ends[:, None] + share[:, None] * along[:, None])


def _end_lacks(capsule: Capsule, contacts: Contacts, scan: RawSurface) -> Array:
    """Room (P,) that the end of a limb lacks, from all of the scan and from where it stands."""
    radius = capsule.radius
    whole = max((radius + scan.flatness) / SLENDER, NARROW)
    touching = 2 * scan.flatness + _AT_TOE
    far = np.unique(
        np.concatenate(
            [
                [0.0],
                np.linspace(touching, NARROW, _NARROWED + 1),
                np.linspace(NARROW, whole, _SLENDER_PARTS + 1),
            ]
        )
    )
    longest = capsule.to_toe + _length(capsule)
    present = (far[1:] >= capsule.to_toe) & (far[:-1] <= longest)  # parts that the axis has
    cuts = _before_toe(capsule, far)  # (P, Q + 1, 3), from the toe on
    at_large = np.where(far[1:] > NARROW + 1e-9, radius, 0.0)  # (Q,)
    places, normals = contacts.places[:, capsule.limb], contacts.normals[:, capsule.limb]
    both = np.concatenate([places, normals], axis=1).reshape(len(cuts), -1)
    groups, member = np.unique(np.nan_to_num(both, nan=np.inf), axis=0, return_inverse=True)
    lacks = np.full(len(cuts), -_TOLD)
    for number in range(len(groups)):
        rows = np.flatnonzero(member.reshape(-1) == number)
        rows = rows[np.isfinite(cuts[rows]).all(axis=(1, 2))]
        if not len(rows):
            continue
        near = cuts[rows].reshape(-1, 3)
        reach = radius + _TOLD
        corners = scan.corners[_meeting(scan.corners, near.min(0) - reach, near.max(0) + reach)]
        first = rows[0]
        at_first = zip(places[first], normals[first], strict=True)
        own = [_stood_on(corners, p, n, scan) for p, n in at_first]
        for chosen in ((False, False), (True, False), (False, True), (True, True)):
            part = corners[(own[0] == chosen[0]) & (own[1] == chosen[1])]
            if not len(part):
                continue
            need = np.broadcast_to(at_large, (len(rows), len(at_large))).copy()
            away = np.linalg.norm(cuts[rows, :2, None] - places[first], axis=-1).max(axis=1)
            need[(away <= touching + 1e-9).any(axis=-1), 0] = -1.0  # the tip, where it stands
            for place, on_it in zip(places[first], chosen, strict=True):
                if on_it:
                    need = np.minimum(need, _cone(cuts[rows], place, scan.flatness, radius))
            need[:, ~present] = -1.0
            begin, end = cuts[rows, :-1].reshape(-1, 3), cuts[rows, 1:].reshape(-1, 3)
            asked = need.reshape(-1)
            kept = np.flatnonzero(asked >= 0)
            gap = _distances(begin[kept], end[kept], part, reach)
            np.maximum.at(lacks, rows[kept // need.shape[1]], asked[kept] - gap)
    return np.where(np.isfinite(cuts).all(axis=(1, 2)), lacks, np.nan)


def _cone(cuts: Array, place: Array, flatness: float, radius: float) -> Array:
    """(B, Q) room asked from the surface of a contact; -1 where it may be touched.

    It grows with the distance from the contact, which is largest at an end of a piece.
    """
    away = np.linalg.norm(cuts - place, axis=-1)
    asked = SLENDER * np.maximum(away[:, :-1], away[:, 1:]) - flatness
    return np.where(asked > 0, np.minimum(asked, radius), -1.0)


def _stood_on(corners: Array, place: Array, normal: Array, scan: RawSurface) -> Mask:
    """(T,) triangles of the surface that a contact is on."""
    if not len(corners) or np.isnan(place).any():
        return np.zeros(len(corners), bool)
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    alike: Mask = own @ normal >= FACING * np.linalg.norm(own, axis=1)
    off = _nearest_on(corners, place) - place
    height = off @ normal
    aside = np.linalg.norm(off - height[:, None] * normal, axis=1)
    return np.asarray(alike & (height <= scan.flatness + RISING * aside))


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
    # A few at a time: in the order of motion these are near each other, and near few triangles
    for at in range(0, len(starts), _SOME):
        part = slice(at, at + _SOME)
        if np.isnan(low[part]).all():
            continue
        some = _meeting(corners, np.nanmin(low[part], axis=0), np.nanmax(high[part], axis=0))
        least, most = corners[some].min(axis=1), corners[some].max(axis=1)
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


def _nearest_on(corners: Array, point: Array) -> Array:
    """(T, 3) the place of each triangle that is nearest to a point."""
    edges = np.roll(corners, -1, axis=1) - corners
    on_edges = _nearest(np.broadcast_to(point, corners.shape), corners, edges)
    nearest = np.linalg.norm(on_edges - point, axis=-1).argmin(axis=1)
    found = on_edges[np.arange(len(corners)), nearest]
    up = np.cross(edges[:, 0], edges[:, 1])
    square = np.maximum((up**2).sum(axis=1), np.finfo(float).tiny)
    foot = point - (((point - corners[:, 0]) * up).sum(axis=1) / square)[:, None] * up
    inward = np.cross(up[:, None], edges)
    within = (((foot[:, None] - corners) * inward).sum(axis=-1) >= 0).all(axis=1)
    return np.where(within[:, None], foot, found)
