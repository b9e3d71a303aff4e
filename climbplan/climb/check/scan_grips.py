"""Checks of the gripped sides of a scan, on the raw triangles.

Where a gripper holds a region of a scan, each finger approaches from half the span along the hold's
axis, a finger's depth below the palm. It has to meet the outside of the raw surface within that
half. The side has to face along the axis, and lean back by no more than planned.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.subject import Subject
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, judge_worst

_CHECK_NAME = "scan.grips"
_MAX_SIDE_ANGLE = np.deg2rad(
    25.5
)  # by which a side may face away from the axis: fingers yield so far
_NO_SIDE = np.pi  # [rad] told of a finger that meets no side
_EDGE_TOLERANCE = 1e-9  # barycentric


def check_gripped_sides(subject: Subject) -> Iterator[Check]:
    """Yield the check, where grippers hold the sides of a scan."""
    plan = subject.plan
    scan, gripper = plan.terrain.scan, plan.robot.gripper
    if scan is None or gripper is None or not scan.finger_depth:
        return
    hold_regions = {
        number: surface
        for number, surface in enumerate(plan.terrain.surfaces)
        if isinstance(surface, Region) and surface.hold is not None
    }
    region = plan.instants.region
    instant, limb = np.nonzero(plan.instants.contact & np.isin(region, list(hold_regions)))
    if not len(instant):
        return
    rows = np.column_stack([region[instant, limb], plan.instants.toes[instant, limb]])
    unique, inverse = np.unique(rows, axis=0, return_inverse=True)
    unique_deficits = np.array(
        [
            _measure_side_deficit(hold_regions[int(row[0])], row[1:], gripper.finger_span / 2, scan)
            for row in unique
        ]
    )
    deficits = unique_deficits[inverse.reshape(-1)]

    def describe_place(row: int) -> str:
        return f"{subject.describe_instant(int(instant[row]))}, {subject.name_limb(int(limb[row]))}"

    if deficits.max() >= _NO_SIDE:
        margin = "a finger meets no side"
    else:
        margin = f"{len(unique)} grips, sides as steep as planned"
    yield judge_worst(_CHECK_NAME, deficits, describe_place, margin)


def _measure_side_deficit(
    region: Region, wrist: Array, half_span: float, scan: RawSurface
) -> float:
    """Return by how much [rad] the worse side faces further away than planned, at least 0."""
    hold, normal = region.hold, region.normal
    assert hold is not None
    grip = wrist - (region.standoff + scan.finger_depth) * normal
    worst = 0.0
    for sign in (1.0, -1.0):
        outward = sign * hold.axis
        side = _find_first_triangle(grip + half_span * outward, grip, scan)
        if side is None or side @ outward <= 0:
            return _NO_SIDE
        undercut = np.arctan2(-(side @ normal), side @ outward)
        side_angle = np.arcsin(min(abs(float(side @ np.cross(normal, outward))), 1.0))
        worst = max(worst, hold.undercut - float(undercut), side_angle - _MAX_SIDE_ANGLE)
    return float(worst)


def _find_first_triangle(start: Array, end: Array, scan: RawSurface) -> Array | None:
    """Return the unit normal of the first triangle on the line from start to end (3,), or None.

    The line's intersection with each plane is tested against all three edges.
    """
    candidates = scan.find_triangles_in(
        np.minimum(start, end) - 1e-9, np.maximum(start, end) + 1e-9
    )
    corners = scan.corners[candidates]
    edges = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normals, axis=1)
    is_valid = length > 0
    corners, edges, normals = corners[is_valid], edges[is_valid], normals[is_valid]
    normals = normals / length[is_valid, None]
    start_height, end_height = (((p - corners[:, 0]) * normals).sum(axis=1) for p in (start, end))
    crosses = (start_height * end_height <= 0) & (np.abs(start_height - end_height) > 1e-12)
    fraction = np.where(
        crosses, start_height / np.where(crosses, start_height - end_height, 1.0), np.inf
    )
    crossing = start + np.where(crosses, fraction, 0.0)[:, None] * (end - start)
    inward = np.cross(normals[:, None], edges)
    inside = ((crossing[:, None] - corners) * inward).sum(axis=-1) >= -_EDGE_TOLERANCE
    fraction = np.where(crosses & inside.all(axis=1), fraction, np.inf)
    if not len(fraction) or not np.isfinite(fraction.min()):
        return None
    return np.asarray(normals[int(fraction.argmin())])
