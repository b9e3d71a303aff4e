"""Checks of links against the raw surface of a scan, with cones of access at footholds.

The required clearances are stated in `climbplan/terrain/raw_surface.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.capsules import Capsule
from climbplan.climb.check.clearance import describe_clearance
from climbplan.climb.check.raw_distances import (
    find_nearest_on_triangles,
    measure_triangle_distances,
)
from climbplan.climb.check.subject import Subject
from climbplan.terrain.raw_surface import FACING, NARROW, RISING, SLENDER, RawSurface
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, judge_worst

REPORTED_CLEARANCE = 5e-3  # [m] room beside links and body up to which it is measured
_NUM_NARROW_PIECES, _NUM_SLENDER_PIECES = 4, 6  # pieces of a limb's last 5 cm, and beyond them
_TOE_TOLERANCE = 2e-3  # [m] beyond the flatness, twice: the last of it, which may touch


@dataclass(frozen=True)
class PoseFootholds:
    """Footholds of N limbs in P poses: present or last one, and the next one."""

    places: Array  # (P, N, 2, 3) [m]; NaN in the second where a limb is not on its way
    normals: Array  # (P, N, 2, 3) unit, into free space

    def select_poses(self, poses: IntArray) -> PoseFootholds:
        """Return the contacts of some poses."""
        return PoseFootholds(self.places[poses], self.normals[poses])


def build_contacts(
    subject: Subject, foothold_round: IntArray, next_round: IntArray
) -> PoseFootholds:
    """Return contacts on footholds of rounds (P, N), and of next rounds; -1 for none."""
    rounds, surfaces = subject.plan.rounds, subject.plan.terrain.surfaces
    rows = np.stack([foothold_round, next_round], axis=-1)
    limbs = np.arange(rows.shape[1])[:, None]
    places = rounds.toes[rows, limbs]
    places[rows < 0] = np.nan
    region = rounds.region[rows, limbs]
    normals = np.zeros_like(places)
    for index, surface in enumerate(surfaces):
        if isinstance(surface, Region):
            normals[region == index] = surface.normal
    return PoseFootholds(places, normals)


def judge_scan_links(
    name: str,
    subject: Subject,
    capsules: Sequence[Capsule],
    contacts: PoseFootholds,
    describe_pose: Callable[[int], str],
) -> Check:
    """Check that links with their thickness miss the raw surface except at their toes.

    `describe_pose` describes a pose of the capsules.
    """
    scan = subject.plan.terrain.scan
    assert scan is not None
    columns = []
    for capsule in capsules:
        # While one limb swings the others stand still: what is alike is measured once
        unique_poses, inverse = _find_unique_poses(capsule, contacts)
        reduced_capsule = replace(
            capsule, starts=capsule.starts[unique_poses], ends=capsule.ends[unique_poses]
        )
        columns.append(
            _measure_axis_clearance(reduced_capsule, contacts.select_poses(unique_poses), scan)[
                inverse
            ]
        )
    distance = np.stack(columns, axis=1)  # (P, C)
    radii = np.array([capsule.radius for capsule in capsules])

    def describe_place(p: int, number: int) -> str:
        capsule = capsules[number]
        return f"{describe_pose(p)}, {subject.name_limb(capsule.limb, capsule.link)} and the scan"

    margin = describe_clearance(distance - radii, radii)
    return judge_worst(
        name, radii - distance, describe_place, margin, radii / np.maximum(distance, 1e-9)
    )


def _find_unique_poses(capsule: Capsule, contacts: PoseFootholds) -> tuple[IntArray, IntArray]:
    """Return poses (K,) before which a capsule or its contacts change, and each pose's index (P,).

    A limb that stands while another swings is in one pose for many samples.
    """
    limb = capsule.limb
    places, normals = contacts.places[:, limb], contacts.normals[:, limb]
    return _find_changes(capsule.starts, capsule.ends, places, normals)


def _find_changes(*features: Array) -> tuple[IntArray, IntArray]:
    """Find where arrays (P, ...) change from one row to the next; the first row counts, too.

    Returns:
        The rows (K,) that differ from the row before, and for each row (P,) the index of the last
        of these up to it.
    """
    flat = np.hstack([values.reshape(len(values), -1) for values in features])
    flat = np.where(np.isnan(flat), np.inf, flat)  # as that all are alike
    is_new = np.append(True, (flat[1:] != flat[:-1]).any(axis=1))
    return np.flatnonzero(is_new), np.cumsum(is_new) - 1


def _measure_axis_clearance(capsule: Capsule, contacts: PoseFootholds, scan: RawSurface) -> Array:
    """Return the clearance (P,) of a capsule's axis, as if its radius were required everywhere."""
    radius = capsule.radius
    starts, ends = capsule.starts, capsule.ends
    shortfall = np.full(len(starts), -REPORTED_CLEARANCE)
    if np.isfinite(capsule.to_toe):
        full_radius_distance = max((radius + scan.flatness) / SLENDER, NARROW)
        shortfall = _measure_end_shortfall(capsule, contacts, scan)
        ends = _locate_along_link(capsule, np.array([full_radius_distance]))[:, 0]
        if full_radius_distance > capsule.to_toe + _measure_length(capsule):
            return radius - shortfall  # near the toe as a whole
    distance = measure_triangle_distances(starts, ends, scan.corners, radius + REPORTED_CLEARANCE)
    return np.minimum(distance, radius - shortfall)


def _measure_length(capsule: Capsule) -> float:
    """Return the length of a capsule's axis [m], the same in all poses."""
    lengths = np.linalg.norm(capsule.starts - capsule.ends, axis=-1)
    return float(lengths.max(initial=0.0, where=np.isfinite(lengths)))


def _locate_along_link(capsule: Capsule, distance_from_toe: Array) -> Array:
    """Return points (P, Q, 3) of a last link at distances (Q,) from the toe."""
    link_vector = capsule.starts - capsule.ends
    fraction = np.clip(
        (distance_from_toe - capsule.to_toe) / max(_measure_length(capsule), 1e-9), 0.0, 1.0
    )
    return np.asarray(capsule.ends[:, None] + fraction[:, None] * link_vector[:, None])


def _measure_end_shortfall(capsule: Capsule, contacts: PoseFootholds, scan: RawSurface) -> Array:
    """Return the clearance (P,) that the end of a limb lacks, from scan and footholds."""
    end = _cut_limb_end(capsule, scan)
    cuts = end.cuts
    places, normals = contacts.places[:, capsule.limb], contacts.normals[:, capsule.limb]
    changes, latest = _find_changes(places, normals)
    contact_features = np.concatenate([places, normals], axis=1)[changes].reshape(len(changes), -1)
    groups, member = np.unique(
        np.nan_to_num(contact_features, nan=np.inf), axis=0, return_inverse=True
    )
    member = member.reshape(-1)[latest]
    shortfall = np.full(len(cuts), -REPORTED_CLEARANCE)
    for group in range(len(groups)):
        rows = np.flatnonzero(member == group)
        rows = rows[np.isfinite(cuts[rows]).all(axis=(1, 2))]
        if not len(rows):
            continue
        first = rows[0]
        shortfall[rows] = _measure_group_shortfall(
            replace(end, cuts=cuts[rows]), places[first], normals[first], scan
        )
    return np.where(np.isfinite(cuts).all(axis=(1, 2)), shortfall, np.nan)


@dataclass(frozen=True)
class _LimbEnd:
    """The end of a limb in Q pieces, from the toe on, in P poses."""

    cuts: Array  # (P, Q + 1, 3) ends of the pieces [m]
    is_present: BoolArray  # (Q,) the link's axis has the piece
    free_clearance: Array  # (Q,) required from surfaces that the limb does not stand on [m]
    radius: float  # [m]


def _cut_limb_end(capsule: Capsule, scan: RawSurface) -> _LimbEnd:
    """Cut the end of a limb into pieces as long as its required clearance is nearly constant."""
    radius = capsule.radius
    full_radius_distance = max((radius + scan.flatness) / SLENDER, NARROW)
    cut_distances = np.unique(
        np.concatenate(
            [
                [0.0],
                np.linspace(_compute_touching_distance(scan), NARROW, _NUM_NARROW_PIECES + 1),
                np.linspace(NARROW, full_radius_distance, _NUM_SLENDER_PIECES + 1),
            ]
        )
    )
    link_extent = capsule.to_toe + _measure_length(capsule)
    is_present = (cut_distances[1:] >= capsule.to_toe) & (cut_distances[:-1] <= link_extent)
    free_clearance = np.where(cut_distances[1:] > NARROW + 1e-9, radius, 0.0)
    return _LimbEnd(_locate_along_link(capsule, cut_distances), is_present, free_clearance, radius)


def _compute_touching_distance(scan: RawSurface) -> float:
    """Return the distance from the toe within which a limb may touch what it stands on [m]."""
    return 2 * scan.flatness + _TOE_TOLERANCE


def _measure_group_shortfall(
    end: _LimbEnd, places: Array, normals: Array, scan: RawSurface
) -> Array:
    """Return the clearance (P,) that the end of a limb lacks in poses with the same contacts.

    places, normals: (2, 3) of the contacts.
    """
    cuts, radius = end.cuts, end.radius
    reach = radius + REPORTED_CLEARANCE
    points = cuts.reshape(-1, 3)
    corners = scan.corners[scan.find_triangles_in(points.min(0) - reach, points.max(0) + reach)]
    contact_triangles = [
        _find_contact_triangles(corners, p, n, scan) for p, n in zip(places, normals, strict=True)
    ]
    shortfall = np.full(len(cuts), -REPORTED_CLEARANCE)
    for membership in ((False, False), (True, False), (False, True), (True, True)):
        triangles = corners[
            (contact_triangles[0] == membership[0]) & (contact_triangles[1] == membership[1])
        ]
        if not len(triangles):
            continue
        required = np.tile(end.free_clearance, (len(cuts), 1))
        contact_distance = np.linalg.norm(cuts[:, :2, None] - places, axis=-1).max(axis=1)
        is_tip = (contact_distance <= _compute_touching_distance(scan) + 1e-9).any(axis=-1)
        required[is_tip, 0] = -1.0  # the tip, where it stands
        for place, is_member in zip(places, membership, strict=True):
            if is_member:
                required = np.minimum(
                    required, _compute_required_clearance(cuts, place, scan.flatness, radius)
                )
        required[:, ~end.is_present] = -1.0
        begin, finish = cuts[:, :-1].reshape(-1, 3), cuts[:, 1:].reshape(-1, 3)
        required_flat = required.reshape(-1)
        pieces = np.flatnonzero(required_flat >= 0)
        piece_gap = measure_triangle_distances(begin[pieces], finish[pieces], triangles, reach)
        np.maximum.at(shortfall, pieces // required.shape[1], required_flat[pieces] - piece_gap)
    return shortfall


def _compute_required_clearance(cuts: Array, place: Array, flatness: float, radius: float) -> Array:
    """Return the clearance (B, Q) required from the surface of a contact; -1 where touching is
    allowed.

    It grows with the distance from the contact, which is largest at an end of a piece.
    """
    distance = np.linalg.norm(cuts - place, axis=-1)
    required = SLENDER * np.maximum(distance[:, :-1], distance[:, 1:]) - flatness
    return np.where(required > 0, np.minimum(required, radius), -1.0)


def _find_contact_triangles(
    corners: Array, place: Array, normal: Array, scan: RawSurface
) -> BoolArray:
    """Return which triangles (T,) belong to the surface that a contact is on."""
    if not len(corners) or np.isnan(place).any():
        return np.zeros(len(corners), bool)
    normal_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_facing: BoolArray = normal_vectors @ normal >= FACING * np.linalg.norm(
        normal_vectors, axis=1
    )
    offset = find_nearest_on_triangles(corners, place) - place
    height = offset @ normal
    lateral = np.linalg.norm(offset - height[:, None] * normal, axis=1)
    return np.asarray(is_facing & (height <= scan.flatness + RISING * lateral))
