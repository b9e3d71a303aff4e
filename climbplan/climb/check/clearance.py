"""Checks that body and limbs are clear of obstacles and of the material behind surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.capsules import Capsule
from climbplan.climb.check.anew.kinematics import compute_body_axes, transform_to_world
from climbplan.climb.check.convex import (
    ConvexBody,
    compute_polygon_normal,
    measure_body_clearance,
    measure_chain_separation,
)
from climbplan.climb.check.distances import measure_chain_distance
from climbplan.climb.check.subject import Subject
from climbplan.terrain.raw_surface import SLENDER
from climbplan.terrain.surfaces import Region, Tube
from climbplan.verification.check import Check, judge_worst

_IN_SCAN = "all that is solid is in the scan"
_MEASURED_DISTANCE = 0.05  # [m] link distances below this are measured, beyond it a bound is enough
_REPORTED_CLEARANCE = 5e-3  # [m] room beside links up to which it is measured, not bounded
_FACE_TOLERANCE = 1e-6  # [m] a surface this close to an obstacle's face lies on it
_TOE_STRETCH = 0.05  # [m] last part of a limb, which has to come close to its surface
_NUM_PIECES = 6  # of a last link up to where it has its whole radius
_FOOT_TOLERANCE = 1e-3  # [m] by which the capsule of a foot may reach beyond its sphere
_UNBOUNDED_CLEARANCE = 1e3  # [m] of links of which no part is looked at


def check_clearance(subject: Subject) -> Iterator[Check]:
    """Yield the checks of the body along the whole motion and of limbs at the instants."""
    yield _check_body(subject)
    yield _check_free_regions(subject)
    yield _check_limbs(subject)
    yield judge_capsules("limbs.collision", subject, subject.capsules, subject.describe_instant)


def _check_body(subject: Subject) -> Check:
    """Check the hull at every instant and every sample of the motion, with exact rotation."""
    plan = subject.plan
    required = plan.limits.body_clearance
    poses = np.vstack(
        [
            np.hstack([plan.instants.com, plan.instants.rpy]),
            np.hstack([plan.trajectory.com, plan.trajectory.rpy]),
        ]
    )
    # The body stands still most of the time: look at each pose once.
    is_new_pose = np.append(True, (np.diff(poses, axis=0) != 0).any(axis=1))
    rows = np.flatnonzero(is_new_pose)
    com, axes = poses[rows, :3], compute_body_axes(poses[rows, 3:])

    if not subject.solids and not any(isinstance(s, Tube) for s in plan.terrain.surfaces):
        return judge_worst("body.clearance", np.zeros(1), lambda _: "", margin=_IN_SCAN)
    names: list[str] = []
    clearances: list[Array] = []
    for solid in subject.solids:
        names.append(solid.name)
        clearances.append(measure_body_clearance(com, axes, subject.body, solid, required))
    for surface in plan.terrain.surfaces:
        if isinstance(surface, Tube):
            corners = transform_to_world(com, axes, subject.body.corners)[..., :2] - surface.center
            names.append(surface.name)
            clearances.append(surface.wall - np.linalg.norm(corners, axis=-1).max(axis=1))
    min_clearance = np.stack(clearances, axis=-1)  # (P, S)

    def describe_place(pose: int, solid: int) -> str:
        row = int(rows[pose])
        count = plan.instants.count
        moment = (
            subject.describe_instant(row) if row < count else subject.describe_time(row - count)
        )
        return f"{moment}, body and {names[solid]}"

    return judge_worst(
        "body.clearance",
        required - min_clearance,
        describe_place,
        margin=f"{1e3 * min_clearance.min():.1f} mm, asked {1e3 * required:.1f} mm",
        used=required / np.maximum(min_clearance, 1e-9),
    )


def _check_free_regions(subject: Subject) -> Check:
    """Check that the hull is in one free region of each choice at the end of every round.

    A choice of single half-spaces stands for an obstacle's faces. The obstacle itself is checked
    exactly elsewhere.
    """
    plan = subject.plan
    rounds = plan.rounds
    corners = transform_to_world(
        rounds.com, compute_body_axes(rounds.rpy), subject.body.corners
    )  # (M+1, V, 3)
    outside = np.zeros((len(rounds.com), 1))
    for choice in plan.terrain.free_choices:
        if choice and any(len(free.b) > 1 for free in choice):
            violations = [(corners @ free.A.T - free.b).max(axis=(1, 2)) for free in choice]
            outside = np.column_stack([outside, np.min(violations, axis=0)])
    return judge_worst(
        "body.free_region",
        np.where(outside < 0, 0.0, outside),
        lambda j, choice: f"{subject.describe_posture(j)}, choice {choice}",
    )


def _check_limbs(subject: Subject) -> Check:
    """Check link axes at the instants; the margin leaves out the last stretch before the toes."""
    points = subject.limbs.points
    depth = measure_link_depths(subject, points, 0.0)
    clearance = -float(
        measure_link_depths(subject, _shorten_last_links(subject, points), _MEASURED_DISTANCE).max(
            initial=-_MEASURED_DISTANCE
        )
    )
    qualifier = "at least " if clearance >= _MEASURED_DISTANCE else ""
    margin = f"links {qualifier}{1e3 * clearance:.0f} mm clear"
    return judge_link_depths(
        "limbs.axis_collision", subject, depth, subject.describe_instant, margin
    )


def _shorten_last_links(subject: Subject, points: Array) -> Array:
    """Return joints and toes (..., N, P, 3) without the last stretch before the toe."""
    shorter = points.copy()
    last_link = points[..., -1, :] - points[..., -2, :]
    length = np.maximum(np.linalg.norm(last_link, axis=-1, keepdims=True), 1e-12)
    shorter[..., -1, :] -= last_link * np.minimum(_TOE_STRETCH / length, 1.0)
    return shorter


def measure_link_depths(subject: Subject, points: Array, sufficient: float) -> Array:
    """Return the depth of link axes in solids (..., N, P - 1, S) [m], negative outside.

    Outside, the value is minus a lower bound on the distance, which is exact only below
    `sufficient`.

    Args:
        subject: The plan under verification.
        points: (..., N, P, 3) joints and toes [m].
        sufficient: Distance [m] above which a bound is enough.
    """
    depths = [-measure_chain_separation(points, solid, sufficient) for solid in subject.solids]
    for surface in subject.plan.terrain.surfaces:
        if isinstance(surface, Tube):
            # The inside is convex: a segment stays in it if its ends do.
            radial = np.linalg.norm(points[..., :2] - surface.center, axis=-1) - surface.wall
            depths.append(np.maximum(radial[..., :-1], radial[..., 1:]))
    if not depths:
        return np.full((*points.shape[:-2], points.shape[-2] - 1, 0), -np.inf)
    return np.stack(depths, axis=-1)


def judge_link_depths(
    name: str, subject: Subject, depth: Array, describe_pose: Callable[[int], str], margin: str
) -> Check:
    """Judge link depths (P, N, links, S); `describe_pose` describes the first index."""
    if not depth.shape[-1]:
        return judge_worst(name, np.zeros(1), lambda _: "", margin=_IN_SCAN)
    names = [solid.name for solid in subject.solids]
    names += [s.name for s in subject.plan.terrain.surfaces if isinstance(s, Tube)]

    def describe_place(p: int, limb: int, link: int, solid: int) -> str:
        link_name = f"{subject.name_limb(limb, link)} link"
        return f"{describe_pose(p)}, {link_name} and {names[solid]}"

    return judge_worst(name, depth, describe_place, margin)


def judge_capsules(
    name: str, subject: Subject, capsules: Sequence[Capsule], describe_pose: Callable[[int], str]
) -> Check:
    """Check that links with their thickness miss all solids and surfaces.

    A last link may come close to what its limb may stand on. There a point of its axis at distance
    d from the toe keeps min(r, f + d / 4), where r is the radius of the link and f that of a
    spherical foot. Without such a foot the last 5 cm are left out. The foot itself is checked by
    `trajectory.feet`.

    Args:
        name: Name of the check.
        subject: The plan under verification.
        capsules: Capsules of all limbs, in P poses.
        describe_pose: Describes a pose.
    """
    solids = subject.solids
    tubes = [s for s in subject.plan.terrain.surfaces if isinstance(s, Tube)]
    if not solids and not tubes:
        return judge_worst(name, np.zeros(1), lambda _: "", margin=_IN_SCAN)
    foot = subject.plan.robot.foot
    standing_parts = [
        _cut_last_link(c, 0.0 if foot is None or foot.sole else foot.radius) for c in capsules
    ]
    axes = np.stack([capsule.axis for capsule in capsules], axis=1)  # (P, C, 2, 3)
    rows: list[Array] = []
    all_solids: list[ConvexBody | Tube] = [*solids, *tubes]
    for solid, may_stand in zip(all_solids, _find_standing_limbs(subject), strict=True):
        distance = _measure_face_distances(axes, solid)
        for index, capsule in enumerate(capsules):
            close_poses = np.flatnonzero(
                ~(distance[:, index] >= capsule.radius + _REPORTED_CLEARANCE)
            )  # NaN stays
            if not len(close_poses):
                continue
            pieces = (
                standing_parts[index]
                if may_stand[capsule.limb]
                else [(capsule.axis, capsule.radius)]
            )
            clearance = np.full(len(close_poses), _UNBOUNDED_CLEARANCE)
            for axis, piece_radius in pieces:
                piece_clearance = (
                    _measure_distances(axis[close_poses], solid, piece_radius + _REPORTED_CLEARANCE)
                    - piece_radius
                )
                clearance = np.minimum(clearance, piece_clearance)
            distance[close_poses, index] = clearance + capsule.radius
        rows.append(distance)
    distances = np.stack(rows, axis=-1)  # (P, C, S)
    radius = np.array([capsule.radius for capsule in capsules])[:, None]
    names = [solid.name for solid in solids] + [tube.name for tube in tubes]

    def describe_place(p: int, number: int, solid: int) -> str:
        capsule = capsules[number]
        link_name = subject.name_limb(capsule.limb, capsule.link)
        return f"{describe_pose(p)}, {link_name} and {names[solid]}"

    load_ratio = radius / np.maximum(distances, 1e-9)
    margin = describe_clearance(distances - radius, radius)
    return judge_worst(name, radius - distances, describe_place, margin, load_ratio)


def describe_clearance(clearance: Array, radius: Array) -> str:
    """Describe the smallest clearance of links with their radii."""
    min_clearance, min_radius, max_radius = (
        float(clearance.min()),
        float(radius.min()),
        float(radius.max()),
    )
    text = f"at least {1e3 * min_clearance:.1f} mm clear"
    if not min_clearance >= 0:
        text = f"{-1e3 * min_clearance:.1f} mm too close"
    span = (
        f"{1e3 * max_radius:.0f} mm"
        if min_radius == max_radius
        else f"{1e3 * min_radius:.0f} to {1e3 * max_radius:.0f} mm"
    )
    return f"links of radius {span} {text}"


def _cut_last_link(capsule: Capsule, foot: float) -> list[tuple[Array, float]]:
    """Return axes (P, 2, 3) and radii of a link's pieces next to what its limb stands on.

    A last link is cut into pieces, each with the radius of its thinner end.
    """
    axis, radius = capsule.axis, capsule.radius
    if not np.isfinite(capsule.to_toe):
        return [(axis, radius)]
    link_vector = capsule.starts - capsule.ends
    lengths = np.linalg.norm(link_vector, axis=-1)
    length = float(np.max(lengths, initial=0.0, where=np.isfinite(lengths)))
    to_start = capsule.to_toe + length
    if to_start + radius <= foot + _FOOT_TOLERANCE:
        return []
    first = 0.0 if foot > 0 else _TOE_STRETCH
    full_radius_distance = max((radius - foot) / SLENDER, first)
    cuts = (
        [*np.linspace(first, full_radius_distance, _NUM_PIECES + 1)]
        if full_radius_distance > first
        else [first]
    )
    cuts = [cut for cut in (*cuts, to_start) if capsule.to_toe < cut <= to_start]
    piece_start = capsule.to_toe if first <= capsule.to_toe else first
    pieces = []
    for piece_end in cuts:
        if piece_end <= piece_start:
            continue
        fractions = (np.array([piece_end, piece_start]) - capsule.to_toe) / max(length, 1e-9)
        piece = capsule.ends[:, None] + fractions[:, None] * link_vector[:, None]
        pieces.append((piece, min(radius, foot + SLENDER * piece_start)))
        piece_start = piece_end
    if not pieces and piece_start <= to_start:  # a sphere
        pieces.append((axis, min(radius, foot + SLENDER * piece_start)))
    return pieces


def _measure_face_distances(axes: Array, solid: ConvexBody | Tube) -> Array:
    """Return lower bounds (...) on the distances of axes (..., 2, 3) from a solid, by its faces."""
    if isinstance(solid, Tube):
        # The inside is convex: a segment is as far from the wall as the nearer of its ends
        radial = np.linalg.norm(axes[..., :2] - solid.center, axis=-1)
        return np.asarray(solid.wall - radial.max(axis=-1))
    return solid.separation_by_faces(axes)[..., 0]


def _measure_distances(axis: Array, solid: ConvexBody | Tube, sufficient: float) -> Array:
    """Return distances (P,) of an axis (P, 2, 3) from a solid, exact up to `sufficient` [m]."""
    if isinstance(solid, Tube):
        return _measure_face_distances(axis, solid)
    return measure_chain_distance(axis, solid, sufficient)[..., 0]


def _find_standing_limbs(subject: Subject) -> Iterator[BoolArray]:
    """Yield for every solid and tube which limbs (N,) may stand on it.

    A limb may stand on a solid if it may stand on a surface that lies on the solid's face. The
    material behind a surface counts if another surface is in the same plane.
    """
    terrain = subject.plan.terrain
    obstacles = len(terrain.obstacles)
    for solid_index, solid in enumerate(subject.solids):
        may_stand = np.zeros(subject.plan.robot.limb_count, bool)
        for surface_index, surface in enumerate(terrain.surfaces):
            if isinstance(surface, Region):
                normal = compute_polygon_normal(surface.vertices)
                contact_corners = surface.vertices - surface.standoff * normal
                distances = solid.face_distances(contact_corners)  # (V, F)
                face = (np.abs(distances).max(axis=0) < _FACE_TOLERANCE) & (
                    solid.normals @ normal > 0
                )
                if face.any() and (solid_index >= obstacles or distances.max() < _FACE_TOLERANCE):
                    may_stand |= terrain.allowed[:, surface_index]
        yield may_stand
    for surface_index, surface in enumerate(terrain.surfaces):
        if isinstance(surface, Tube):
            yield terrain.allowed[:, surface_index]
