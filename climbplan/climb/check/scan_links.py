"""Links against the raw surface of a scan: their radius from all of it, a cone where they stand.

What limbs keep, and where, is stated in `climbplan/terrain/raw_surface.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.capsules import Capsule
from climbplan.climb.check.clearance import told_room
from climbplan.climb.check.raw_distances import distances, meeting, nearest_on
from climbplan.climb.check.subject import Subject
from climbplan.terrain.raw_surface import FACING, NARROW, RISING, SLENDER, RawSurface
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, judge_worst

TOLD = 5e-3  # [m] room beside links and body up to which it is measured
_NARROWED, _SLENDER_PARTS = 4, 6  # pieces of a limb's last 5 cm, and beyond them
_AT_TOE = 2e-3  # [m] beyond the flatness, twice: the last of it, which may touch


@dataclass(frozen=True)
class Contacts:
    """Where limbs stand, or have stood and will stand, for P poses and N limbs."""

    places: Array  # (P, N, 2, 3) [m]; NaN in the second where a limb is not on its way
    normals: Array  # (P, N, 2, 3) unit, into free space

    def at(self, poses: IntArray) -> Contacts:
        """Those of some poses."""
        return Contacts(self.places[poses], self.normals[poses])


def contacts_on(subject: Subject, stood: IntArray, next_one: IntArray) -> Contacts:
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


def _different(capsule: Capsule, contacts: Contacts) -> tuple[IntArray, IntArray]:
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
    lacks = np.full(len(starts), -TOLD)
    if np.isfinite(capsule.to_toe):
        whole = max((radius + scan.flatness) / SLENDER, NARROW)
        lacks = _end_lacks(capsule, contacts, scan)
        ends = _before_toe(capsule, np.array([whole]))[:, 0]
        if whole > capsule.to_toe + _length(capsule):
            return radius - lacks  # near the toe as a whole
    clear = distances(starts, ends, scan.corners, radius + TOLD)
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
    lacks = np.full(len(cuts), -TOLD)
    for number in range(len(groups)):
        rows = np.flatnonzero(member.reshape(-1) == number)
        rows = rows[np.isfinite(cuts[rows]).all(axis=(1, 2))]
        if not len(rows):
            continue
        near = cuts[rows].reshape(-1, 3)
        reach = radius + TOLD
        corners = scan.corners[meeting(scan.corners, near.min(0) - reach, near.max(0) + reach)]
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
            gap = distances(begin[kept], end[kept], part, reach)
            np.maximum.at(lacks, rows[kept // need.shape[1]], asked[kept] - gap)
    return np.where(np.isfinite(cuts).all(axis=(1, 2)), lacks, np.nan)


def _cone(cuts: Array, place: Array, flatness: float, radius: float) -> Array:
    """(B, Q) room asked from the surface of a contact; -1 where it may be touched.

    It grows with the distance from the contact, which is largest at an end of a piece.
    """
    away = np.linalg.norm(cuts - place, axis=-1)
    asked = SLENDER * np.maximum(away[:, :-1], away[:, 1:]) - flatness
    return np.where(asked > 0, np.minimum(asked, radius), -1.0)


def _stood_on(corners: Array, place: Array, normal: Array, scan: RawSurface) -> BoolArray:
    """(T,) triangles of the surface that a contact is on."""
    if not len(corners) or np.isnan(place).any():
        return np.zeros(len(corners), bool)
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    alike: BoolArray = own @ normal >= FACING * np.linalg.norm(own, axis=1)
    off = nearest_on(corners, place) - place
    height = off @ normal
    aside = np.linalg.norm(off - height[:, None] * normal, axis=1)
    return np.asarray(alike & (height <= scan.flatness + RISING * aside))
