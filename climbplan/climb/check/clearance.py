"""Body and limbs keep clear of obstacles and of the material behind surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.capsules import Capsule
from climbplan.climb.check.anew.kinematics import body_axes, placed
from climbplan.climb.check.convex import (
    ConvexBody,
    body_clearance,
    chain_separation,
    polygon_normal,
)
from climbplan.climb.check.distances import chain_distance
from climbplan.climb.check.subject import Subject
from climbplan.terrain.raw_surface import SLENDER
from climbplan.terrain.surfaces import Region, Tube
from climbplan.verification.check import Check, judge_worst

_IN_SCAN = "all that is solid is in the scan"
_MEASURED = 0.05  # [m] link distances below this are measured, beyond it a bound is enough
_TOLD = 5e-3  # [m] room beside links up to which it is measured, not bounded
_ON_FACE = 1e-6  # [m] a surface this close to an obstacle's face lies on it
_TOE_STRETCH = 0.05  # [m] last part of a limb, which has to come close to its surface
_PIECES = 6  # of a last link up to where it has its whole radius
_FOOT_ITSELF = 1e-3  # [m] by which the capsule of a foot may reach beyond its sphere
_FAR = 1e3  # [m] of links of which no part is looked at


def clearance_checks(subject: Subject) -> Iterator[Check]:
    """Body along the whole motion, and limbs at the instants."""
    yield _body(subject)
    yield _free_regions(subject)
    yield _limbs(subject)
    yield judge_capsules("limbs.capsules", subject, subject.capsules, subject.at)


def _body(subject: Subject) -> Check:
    """The hull at every instant and every sample of the motion, with exact rotation."""
    plan = subject.plan
    asked = plan.limits.body_clearance
    poses = np.vstack(
        [
            np.hstack([plan.instants.com, plan.instants.rpy]),
            np.hstack([plan.trajectory.com, plan.trajectory.rpy]),
        ]
    )
    # The body stands still most of the time: look at each pose once.
    moved = np.append(True, (np.diff(poses, axis=0) != 0).any(axis=1))
    rows = np.flatnonzero(moved)
    com, axes = poses[rows, :3], body_axes(poses[rows, 3:])

    if not subject.solids and not any(isinstance(s, Tube) for s in plan.terrain.surfaces):
        return judge_worst("body.clearance", np.zeros(1), lambda _: "", margin=_IN_SCAN)
    names: list[str] = []
    clear: list[Array] = []
    for solid in subject.solids:
        names.append(solid.name)
        clear.append(body_clearance(com, axes, subject.body, solid, asked))
    for surface in plan.terrain.surfaces:
        if isinstance(surface, Tube):
            corners = placed(com, axes, subject.body.corners)[..., :2] - surface.center
            names.append(surface.name)
            clear.append(surface.wall - np.linalg.norm(corners, axis=-1).max(axis=1))
    least = np.stack(clear, axis=-1)  # (P, S)

    def where(pose: int, solid: int) -> str:
        row = int(rows[pose])
        count = plan.instants.count
        moment = subject.at(row) if row < count else subject.at_time(row - count)
        return f"{moment}, body and {names[solid]}"

    return judge_worst(
        "body.clearance",
        asked - least,
        where,
        margin=f"{1e3 * least.min():.1f} mm, asked {1e3 * asked:.1f} mm",
        used=asked / np.maximum(least, 1e-9),
    )


def _free_regions(subject: Subject) -> Check:
    """At the end of every round the hull lies in one free region of each choice.

    A choice of single half-spaces stands for an obstacle's faces: the obstacle itself is checked,
    which is exact.
    """
    plan = subject.plan
    rounds = plan.rounds
    corners = placed(rounds.com, body_axes(rounds.rpy), subject.body.corners)  # (M+1, V, 3)
    outside = np.zeros((len(rounds.com), 1))
    for choice in plan.terrain.free_choices:
        if choice and any(len(free.b) > 1 for free in choice):
            past = [(corners @ free.A.T - free.b).max(axis=(1, 2)) for free in choice]
            outside = np.column_stack([outside, np.min(past, axis=0)])
    return judge_worst(
        "body.free_region",
        np.where(outside < 0, 0.0, outside),
        lambda j, choice: f"{subject.posture(j)}, choice {choice}",
    )


def _limbs(subject: Subject) -> Check:
    """Link axes at the instants; the margin leaves out the last stretch before the toes."""
    points = subject.limbs.points
    depth = link_depths(subject, points, 0.0)
    clear = -float(
        link_depths(subject, _narrowed(subject, points), _MEASURED).max(initial=-_MEASURED)
    )
    at_least = "at least " if clear >= _MEASURED else ""
    margin = f"links {at_least}{1e3 * clear:.0f} mm clear"
    return judge_link_depths("limbs.clearance", subject, depth, subject.at, margin)


def _narrowed(subject: Subject, points: Array) -> Array:
    """Joints and toes (..., N, P, 3) without the last stretch before the toe."""
    shorter = points.copy()
    last = points[..., -1, :] - points[..., -2, :]
    length = np.maximum(np.linalg.norm(last, axis=-1, keepdims=True), 1e-12)
    shorter[..., -1, :] -= last * np.minimum(_TOE_STRETCH / length, 1.0)
    return shorter


def link_depths(subject: Subject, points: Array, enough: float) -> Array:
    """Depth of link axes in solids (..., N, P - 1, S) [m], negative outside.

    points: (..., N, P, 3) joints and toes. Outside, the value is minus a lower bound on the
    distance, measured closely only below `enough` [m].
    """
    depths = [-chain_separation(points, solid, enough) for solid in subject.solids]
    for surface in subject.plan.terrain.surfaces:
        if isinstance(surface, Tube):
            # The inside is convex: a segment stays in it if its ends do.
            radial = np.linalg.norm(points[..., :2] - surface.center, axis=-1) - surface.wall
            depths.append(np.maximum(radial[..., :-1], radial[..., 1:]))
    if not depths:
        return np.full((*points.shape[:-2], points.shape[-2] - 1, 0), -np.inf)
    return np.stack(depths, axis=-1)


def judge_link_depths(
    name: str, subject: Subject, depth: Array, moment: Callable[[int], str], margin: str
) -> Check:
    """A check of link depths (P, N, links, S); `moment` describes the first index."""
    if not depth.shape[-1]:
        return judge_worst(name, np.zeros(1), lambda _: "", margin=_IN_SCAN)
    names = [solid.name for solid in subject.solids]
    names += [s.name for s in subject.plan.terrain.surfaces if isinstance(s, Tube)]

    def where(p: int, limb: int, link: int, solid: int) -> str:
        link_name = f"{subject.limb(limb, link)} link"
        return f"{moment(p)}, {link_name} and {names[solid]}"

    return judge_worst(name, depth, where, margin)


def judge_capsules(
    name: str, subject: Subject, capsules: Sequence[Capsule], moment: Callable[[int], str]
) -> Check:
    """Return a check that links, as thick as they are, miss all solids and surfaces.

    Args:
        name: Of the check.
        subject: The plan under verification.
        capsules: Of all limbs, in P poses.
        moment: Describes a pose.

    A last link may come close to what its limb may stand on. There a point of its axis at
    distance d from the toe keeps min(r, f + d / 4), where r is the radius of the link and f that of
    a spherical foot; without such a foot the last 5 cm are left out. The foot itself is looked at
    by `trajectory.feet`.
    """
    solids = subject.solids
    tubes = [s for s in subject.plan.terrain.surfaces if isinstance(s, Tube)]
    if not solids and not tubes:
        return judge_worst(name, np.zeros(1), lambda _: "", margin=_IN_SCAN)
    foot = subject.plan.robot.foot
    near = [_standing_parts(c, 0.0 if foot is None or foot.sole else foot.radius) for c in capsules]
    axes = np.stack([capsule.axis for capsule in capsules], axis=1)  # (P, C, 2, 3)
    rows: list[Array] = []
    every: list[ConvexBody | Tube] = [*solids, *tubes]
    for solid, stands in zip(every, _stood_upon(subject), strict=True):
        apart = _face_distances(axes, solid)
        for number, capsule in enumerate(capsules):
            close = np.flatnonzero(~(apart[:, number] >= capsule.radius + _TOLD))  # NaN stays
            if not len(close):
                continue
            parts = near[number] if stands[capsule.limb] else [(capsule.axis, capsule.radius)]
            room = np.full(len(close), _FAR)
            for axis, own in parts:
                beyond = _distances(axis[close], solid, own + _TOLD) - own
                room = np.minimum(room, beyond)
            apart[close, number] = room + capsule.radius
        rows.append(apart)
    clear = np.stack(rows, axis=-1)  # (P, C, S)
    radius = np.array([capsule.radius for capsule in capsules])[:, None]
    names = [solid.name for solid in solids] + [tube.name for tube in tubes]

    def where(p: int, number: int, solid: int) -> str:
        capsule = capsules[number]
        link_name = subject.limb(capsule.limb, capsule.link)
        return f"{moment(p)}, {link_name} and {names[solid]}"

    used = radius / np.maximum(clear, 1e-9)
    margin = told_room(clear - radius, radius)
    return judge_worst(name, radius - clear, where, margin, used)


def told_room(room: Array, radius: Array) -> str:
    """What links keep at least, with their radii, for a margin."""
    least, thin, thick = float(room.min()), float(radius.min()), float(radius.max())
    words = f"at least {1e3 * least:.1f} mm clear"
    if not least >= 0:
        words = f"{-1e3 * least:.1f} mm too close"
    span = f"{1e3 * thick:.0f} mm" if thin == thick else f"{1e3 * thin:.0f} to {1e3 * thick:.0f} mm"
    return f"links of radius {span} {words}"


def _standing_parts(capsule: Capsule, foot: float) -> list[tuple[Array, float]]:
    """Parts of a link beside what its limb stands on: axes (P, 2, 3), and the room that they keep.

    A last link is cut into pieces, each as thick as at its thinner end.
    """
    axis, radius = capsule.axis, capsule.radius
    if not np.isfinite(capsule.to_toe):
        return [(axis, radius)]
    along = capsule.starts - capsule.ends
    lengths = np.linalg.norm(along, axis=-1)
    length = float(np.max(lengths, initial=0.0, where=np.isfinite(lengths)))
    to_start = capsule.to_toe + length
    if to_start + radius <= foot + _FOOT_ITSELF:
        return []
    first = 0.0 if foot > 0 else _TOE_STRETCH
    whole = max((radius - foot) / SLENDER, first)
    cuts = [*np.linspace(first, whole, _PIECES + 1)] if whole > first else [first]
    cuts = [cut for cut in (*cuts, to_start) if capsule.to_toe < cut <= to_start]
    begin = capsule.to_toe if first <= capsule.to_toe else first
    parts = []
    for far in cuts:
        if far <= begin:
            continue
        share = (np.array([far, begin]) - capsule.to_toe) / max(length, 1e-9)
        piece = capsule.ends[:, None] + share[:, None] * along[:, None]
        parts.append((piece, min(radius, foot + SLENDER * begin)))
        begin = far
    if not parts and begin <= to_start:  # a sphere
        parts.append((axis, min(radius, foot + SLENDER * begin)))
    return parts


def _face_distances(axes: Array, solid: ConvexBody | Tube) -> Array:
    """Room (...) that a face of a solid leaves to axes (..., 2, 3): at most their distances."""
    if isinstance(solid, Tube):
        # The inside is convex: a segment is as far from the wall as the nearer of its ends
        radial = np.linalg.norm(axes[..., :2] - solid.center, axis=-1)
        return np.asarray(solid.wall - radial.max(axis=-1))
    return solid.separation_by_faces(axes)[..., 0]


def _distances(axis: Array, solid: ConvexBody | Tube, enough: float) -> Array:
    """Distances (P,) of an axis (P, 2, 3) from a solid, measured up to `enough` [m]."""
    if isinstance(solid, Tube):
        return _face_distances(axis, solid)
    return chain_distance(axis, solid, enough)[..., 0]


def _stood_upon(subject: Subject) -> Iterator[BoolArray]:
    """Yield for every solid and tube (N,) whether limbs may stand on it.

    They may stand on a solid if they may on a surface that lies on its face: the obstacle is behind
    all of that, and the material behind another surface in one plane with it.
    """
    terrain = subject.plan.terrain
    obstacles = len(terrain.obstacles)
    for number, solid in enumerate(subject.solids):
        stands = np.zeros(subject.plan.robot.limb_count, bool)
        for index, surface in enumerate(terrain.surfaces):
            if isinstance(surface, Region):
                normal = polygon_normal(surface.vertices)
                touched = surface.vertices - surface.standoff * normal
                away = solid.face_distances(touched)  # (V, F)
                face = (np.abs(away).max(axis=0) < _ON_FACE) & (solid.normals @ normal > 0)
                if face.any() and (number >= obstacles or away.max() < _ON_FACE):
                    stands |= terrain.allowed[:, index]
        yield stands
    for index, surface in enumerate(terrain.surfaces):
        if isinstance(surface, Tube):
            yield terrain.allowed[:, index]
