"""A plan against the raw surface of its scan, which the file carries: toes, links and body.

Contact regions are what planning made of a scan. Here they are not asked: toes are measured against
the triangles themselves, forces against the normals of these, links and body against all of them.
What limbs keep, and where, is stated in `climbplan/terrain/raw_surface.py`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.check.anew.gait import gait_of
from climbplan.climb.check.anew.kinematics import body_axes, placed
from climbplan.climb.check.convex import hull_distance
from climbplan.climb.check.raw_distances import distances, gaps, meeting
from climbplan.climb.check.scan_grips import gripped_sides
from climbplan.climb.check.scan_links import TOLD, contacts_on, judge_scan_links
from climbplan.climb.check.subject import Subject
from climbplan.terrain.model import STATED
from climbplan.terrain.raw_surface import FACING, RawSurface
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, judge_worst


def scan_checks(subject: Subject, scan: RawSurface) -> Iterator[Check]:
    """Toes, friction and body against the raw surface, and links at the instants."""
    yield _toes(subject, scan)
    yield _friction(subject, scan)
    yield from gripped_sides(subject)
    yield _body(subject, scan)
    stood = gait_of(subject.plan).stood
    contacts = contacts_on(subject, stood, np.zeros_like(stood) - 1)
    yield judge_scan_links("scan.limbs", subject, subject.capsules, contacts, subject.at)


def _standing(subject: Subject) -> tuple[IntArray, IntArray, Array]:
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
    away = distances(places, places, scan.corners, scan.flatness + 0.1)[number.reshape(-1)]

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
        near = meeting(corners, toe - about, toe + about)
        near = near[normals[near] @ normal > FACING]
        ends = np.broadcast_to(toe, (len(near), 3))
        near = near[gaps(ends, ends, corners[near]) <= about]
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
    corners, wide = scan.corners, asked + TOLD
    clear = np.full(len(rows), wide)
    for p, hull in enumerate(hulls):
        for t in meeting(corners, hull.min(axis=0) - wide, hull.max(axis=0) + wide):
            clear[p] = min(clear[p], hull_distance(hull, corners[t]))

    def where(pose: int) -> str:
        row, count = int(rows[pose]), plan.instants.count
        return subject.at(row) if row < count else subject.at_time(row - count)

    least = float(clear.min())
    words = "at least " if least >= wide else ""
    margin = f"{words}{1e3 * least:.1f} mm, asked {1e3 * asked:.1f} mm"
    return judge_worst("scan.body", asked - clear, where, margin, asked / np.maximum(clear, 1e-9))
