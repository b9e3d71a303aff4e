"""Body and limbs keep clear of obstacles and of the material behind surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

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
from climbplan.climb.plan.climb_plan import Mask
from climbplan.plans.check import Array, Check, judge_worst
from climbplan.terrain.surfaces import Region, Tube

_IN_SCAN = "all that is solid is in the scan"
_MEASURED = 0.05  # [m] link distances below this are measured, beyond it a bound is enough
_TOLD = 5e-3  # [m] room beside links up to which it is measured, not bounded
_ON_FACE = 1e-6  # [m] a surface this close to an obstacle's face lies on it
_TOE_STRETCH = 0.05  # [m] last part of a limb, which has to come close to its surface


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
    """A check that links, as thick as they are, miss all obstacles.

    `moment` describes a pose of the capsules. Walls are left out: a last link comes as close to its
    wall as its toe. So it does to an obstacle whose face the limb may stand on: there it counts as
    a capsule up to where it narrows to its toe.
    """
    solids = subject.solids[: len(subject.plan.terrain.obstacles)]
    if not solids:
        return judge_worst(name, np.zeros(1), lambda _: "", margin="no obstacles")
    rows: list[Array] = []
    for solid, stands in zip(solids, _stood_upon(subject), strict=False):
        own = [
            _up_to_narrow(capsule) if stands[capsule.limb] else capsule.axis for capsule in capsules
        ]
        rows.append(_axis_distances(own, solid, [c.radius + _TOLD for c in capsules]))
    clear = np.stack(rows, axis=-1)  # (P, C, S)
    radius = np.array([capsule.radius for capsule in capsules])[:, None]

    def where(p: int, number: int, solid: int) -> str:
        capsule = capsules[number]
        link_name = subject.limb(capsule.limb, capsule.link)
        return f"{moment(p)}, {link_name} and {solids[solid].name}"

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


def _up_to_narrow(capsule: Capsule) -> Array:
    """Axis (P, 2, 3) up to where a last link narrows to its toe; infinitely far if it is all so."""
    back = _TOE_STRETCH - capsule.to_toe
    if not back > 0:
        return capsule.axis
    along = capsule.starts - capsule.ends
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    if float(np.median(length)) <= back:
        return np.full((len(along), 2, 3), np.inf)
    return np.stack([capsule.starts, capsule.ends + along * (back / length)], axis=1)


def _axis_distances(axes: Sequence[Array], solid: ConvexBody, enough: Sequence[float]) -> Array:
    """Distances (P, C) of axes (P, 2, 3) from a solid, each measured up to its `enough` [m]."""
    out = np.full((len(axes[0]), len(axes)), np.inf)
    for limit in sorted(set(enough)):
        own = [n for n, asked in enumerate(enough) if asked == limit]
        own = [n for n in own if not np.isinf(axes[n]).any()]
        if own:
            stacked = np.stack([axes[n] for n in own], axis=1)  # (P, C, 2, 3)
            out[:, own] = chain_distance(stacked, solid, limit)[..., 0]
    return out


def _stood_upon(subject: Subject) -> Iterator[Mask]:
    """(N,) for every obstacle whether limbs may stand on a surface that lies on its face."""
    terrain = subject.plan.terrain
    for solid in subject.solids[: len(terrain.obstacles)]:
        stands = np.zeros(subject.plan.robot.limb_count, bool)
        for index, surface in enumerate(terrain.surfaces):
            if isinstance(surface, Region):
                normal = polygon_normal(surface.vertices)
                touched = surface.vertices - surface.standoff * normal
                away = solid.face_distances(touched)  # (V, F)
                face = (np.abs(away).max(axis=0) < _ON_FACE) & (solid.normals @ normal > 0)
                if face.any() and away.max() < _ON_FACE:
                    stands |= terrain.allowed[:, index]
        yield stands
