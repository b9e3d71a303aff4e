"""Gripped sides of a scan: what fingers close on is measured on the raw triangles.

Where a gripper holds a region of a scan, each finger comes in from half the span along the hold's
axis, a finger's depth below the palm. It has to meet an outside of the raw surface within that
half, which faces along the axis, and leans back by no more than the forces were planned with.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.raw_distances import meeting
from climbplan.climb.check.subject import Subject
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, judge_worst

_NAME = "scan.grips"
_ASIDE = np.deg2rad(25.5)  # by which a side may face away from the axis: fingers yield so far
_NOTHING = np.pi  # [rad] told of a finger that meets no side
_ON_EDGE = 1e-9  # barycentric


def gripped_sides(subject: Subject) -> Iterator[Check]:
    """The check, where grippers hold something of a scan by its sides."""
    plan = subject.plan
    scan, gripper = plan.terrain.scan, plan.robot.gripper
    if scan is None or gripper is None or not scan.finger_depth:
        return
    own = {
        number: surface
        for number, surface in enumerate(plan.terrain.surfaces)
        if isinstance(surface, Region) and surface.hold is not None
    }
    region = plan.instants.region
    instant, limb = np.nonzero(plan.instants.contact & np.isin(region, list(own)))
    if not len(instant):
        return
    rows = np.column_stack([region[instant, limb], plan.instants.toes[instant, limb]])
    unique, back = np.unique(rows, axis=0, return_inverse=True)
    found = np.array(
        [_lacking(own[int(row[0])], row[1:], gripper.finger_span / 2, scan) for row in unique]
    )
    lacking = found[back.reshape(-1)]

    def where(row: int) -> str:
        return f"{subject.at(int(instant[row]))}, {subject.limb(int(limb[row]))}"

    if lacking.max() >= _NOTHING:
        margin = "a finger meets no side"
    else:
        margin = f"{len(unique)} grips, sides as steep as planned"
    yield judge_worst(_NAME, lacking, where, margin)


def _lacking(region: Region, wrist: Array, half: float, scan: RawSurface) -> float:
    """By how much [rad] the worse side faces away further than planned; zero where it does not."""
    hold, normal = region.hold, region.normal
    assert hold is not None
    grip = wrist - (region.standoff + scan.finger_depth) * normal
    worst = 0.0
    for sign in (1.0, -1.0):
        out = sign * hold.axis
        side = _first_met(grip + half * out, grip, scan)
        if side is None or side @ out <= 0:
            return _NOTHING
        undercut = np.arctan2(-(side @ normal), side @ out)
        aside = np.arcsin(min(abs(float(side @ np.cross(normal, out))), 1.0))
        worst = max(worst, hold.undercut - float(undercut), aside - _ASIDE)
    return float(worst)


def _first_met(start: Array, end: Array, scan: RawSurface) -> Array | None:
    """Unit normal of the first triangle that the way from start to end (3,) meets; None for none.

    Where it meets each plane, and whether that place is on the inner side of all three edges.
    """
    near = meeting(scan.corners, np.minimum(start, end) - 1e-9, np.maximum(start, end) + 1e-9)
    corners = scan.corners[near]
    edges = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normals, axis=1)
    sound = length > 0
    corners, edges, normals = corners[sound], edges[sound], normals[sound]
    normals = normals / length[sound, None]
    high, low = (((p - corners[:, 0]) * normals).sum(axis=1) for p in (start, end))
    crosses = (high * low <= 0) & (np.abs(high - low) > 1e-12)
    share = np.where(crosses, high / np.where(crosses, high - low, 1.0), np.inf)
    place = start + np.where(crosses, share, 0.0)[:, None] * (end - start)
    inward = np.cross(normals[:, None], edges)
    inside = ((place[:, None] - corners) * inward).sum(axis=-1) >= -_ON_EDGE
    share = np.where(crosses & inside.all(axis=1), share, np.inf)
    if not len(share) or not np.isfinite(share.min()):
        return None
    return np.asarray(normals[int(share.argmin())])
