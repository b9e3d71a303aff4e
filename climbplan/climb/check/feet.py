"""Feet of finite size keep out of all that is solid: they touch it, and no more.

Flat feet lie on their surfaces, all four corners of their soles on them.

Links narrow to their toes where they stand; what is round the toe is looked at here, at the surface
that it stands on as at everything beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.soles import corners, lying, soles_at
from climbplan.climb.check.convex import polygon_edges, polygon_normal
from climbplan.climb.check.distances import chain_distance
from climbplan.climb.check.raw_distances import distances
from climbplan.climb.check.subject import Subject
from climbplan.terrain.surfaces import Region, Tube
from climbplan.verification.check import Check, judge_worst

_TOLD = 0.05  # [m] room beside feet up to which it is measured


def feet_check(subject: Subject) -> Iterator[Check]:
    """At the instants; nothing for point toes."""
    plan = subject.plan
    if plan.robot.sole is None:
        yield from judge_feet("limbs.feet", subject, plan.instants.toes, subject.at)
        return
    soles = soles_at(plan.robot, subject.axes, plan.instants.joint_angles)
    deep = _sole_depth(subject, subject.limbs.toe, soles)
    lies = _off_surface(subject, soles)
    worst = np.maximum(deep.max(axis=(-1, -2)), lies)
    yield judge_worst("limbs.feet", worst, subject.at, _margin_of_soles(deep))


def judge_soles(
    name: str, subject: Subject, toes: Array, soles: Array, moment: Callable[[int], str]
) -> Iterator[Check]:
    """A check of soles about toes (P, N, 3) of rows (P, N, 3, 3), world, against all solids."""
    names = [solid.name for solid in subject.solids]
    deep = _sole_depth(subject, toes, soles)

    def where(p: int, limb: int, corner: int, solid: int) -> str:
        return f"{moment(p)}, sole of {subject.limb(limb)} and {names[solid]}"

    yield judge_worst(name, deep, where, _margin_of_soles(deep))


def _margin_of_soles(deep: Array) -> str:
    return f"soles at most {max(1e3 * float(deep.max(initial=0.0)), 0.0):.2f} mm deep"


def _sole_depth(subject: Subject, toes: Array, soles: Array) -> Array:
    """(P, N, 5, S) how deep corners and middles of soles are in solids [m]; none without any."""
    sole = subject.plan.robot.sole
    assert sole is not None
    points = toes[..., None, :] + np.concatenate(
        [corners(sole, soles), np.zeros((*toes.shape[:-1], 1, 3))], axis=-2
    )
    if not subject.solids:
        return np.full((*points.shape[:-1], 1), -np.inf)
    pieces = np.stack([points, points], axis=-2)
    room = [chain_distance(pieces, solid, _TOLD)[..., 0] for solid in subject.solids]
    return -np.stack(room, axis=-1)


def _off_surface(subject: Subject, soles: Array) -> Array:
    """(K, N) how far standing soles lie off their surfaces or reach beyond them [m].

    A radian of the sole from where it is to lie counts as one metre.
    """
    plan, sole = subject.plan, subject.plan.robot.sole
    assert sole is not None
    instants = plan.instants
    off = np.linalg.norm(soles - lying(sole, instants.normal), axis=-1).max(axis=-1)
    points = subject.limbs.toe[..., None, :] + corners(sole, soles)
    for index, surface in enumerate(plan.terrain.surfaces):
        here = instants.region == index
        if not isinstance(surface, Region):
            off[here] = np.inf
            continue
        normal = polygon_normal(surface.vertices)
        outward, offsets = polygon_edges(surface.vertices, normal)
        past = (points[here] @ outward.T - offsets).max(axis=(-1, -2), initial=-np.inf)
        high = np.abs((points[here] - surface.vertices[0]) @ normal).max(axis=-1, initial=0.0)
        off[here] = np.maximum(off[here], np.maximum(past, high))
    return np.where(instants.contact, off, -np.inf)


def judge_feet(
    name: str, subject: Subject, toes: Array, moment: Callable[[int], str]
) -> Iterator[Check]:
    """A check of feet round toes (P, N, 3), world; `moment` describes a row."""
    foot, terrain = subject.plan.robot.foot, subject.plan.terrain
    if foot is None:
        return
    enough = foot.radius + _TOLD
    points = np.stack([toes, toes], axis=-2)
    names = [solid.name for solid in subject.solids]
    room = [chain_distance(points, solid, enough)[..., 0] for solid in subject.solids]
    for surface in terrain.surfaces:
        if isinstance(surface, Tube):
            names.append(surface.name)
            away = np.linalg.norm(toes[..., :2] - surface.center, axis=-1)
            room.append(surface.wall - away)
    if terrain.scan is not None:  # which regions lie so near, at most
        places, number = np.unique(toes.reshape(-1, 3), axis=0, return_inverse=True)
        away = distances(places, places, terrain.scan.corners, enough)[number.reshape(-1)]
        names.append("the scan")
        room.append(away.reshape(toes.shape[:-1]) + terrain.scan.flatness)
    if not room:
        yield judge_worst(name, np.zeros(1), lambda _: "", margin="nothing is solid")
        return
    least = np.stack(room, axis=-1)

    def where(p: int, limb: int, solid: int) -> str:
        return f"{moment(p)}, foot of {subject.limb(limb)} and {names[solid]}"

    deep = max(-1e3 * float((least - foot.radius).min()), 0.0)
    margin = f"feet of {1e3 * foot.radius:.0f} mm at most {deep:.2f} mm deep"
    yield judge_worst(name, foot.radius - least, where, margin)
