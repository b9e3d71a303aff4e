"""Checks that feet of finite size touch solids without entering them.

Flat feet lie on their surfaces with all four corners of their soles. Links narrow to their toes
where they stand. The space around the toe is checked here, at the surface that it stands on and at
everything else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.soles import (
    build_sole_axes,
    compute_corner_offsets,
    compute_sole_axes,
)
from climbplan.climb.check.convex import compute_polygon_edges, compute_polygon_normal
from climbplan.climb.check.distances import measure_chain_distance
from climbplan.climb.check.raw_distances import measure_triangle_distances
from climbplan.climb.check.subject import Subject
from climbplan.terrain.surfaces import Region, Tube
from climbplan.verification.check import Check, judge_worst

_REPORTED_CLEARANCE = 0.05  # [m] room beside feet up to which it is measured


def check_feet(subject: Subject) -> Iterator[Check]:
    """Yield the check of feet at the instants; nothing for point feet."""
    plan = subject.plan
    if plan.robot.sole is None:
        yield from judge_feet("limbs.feet", subject, plan.instants.toes, subject.describe_instant)
        return
    soles = build_sole_axes(plan.robot, subject.axes, plan.instants.joint_angles)
    depth = _measure_sole_depth(subject, subject.limbs.toe, soles)
    surface_error = _measure_surface_error(subject, soles)
    worst = np.maximum(depth.max(axis=(-1, -2)), surface_error)
    yield judge_worst("limbs.feet", worst, subject.describe_instant, _describe_sole_margin(depth))


def judge_soles(
    name: str, subject: Subject, toes: Array, soles: Array, describe_pose: Callable[[int], str]
) -> Iterator[Check]:
    """Yield the check of soles with axes (P, N, 3, 3) at toes (P, N, 3), world."""
    names = [solid.name for solid in subject.solids]
    depth = _measure_sole_depth(subject, toes, soles)

    def describe_place(p: int, limb: int, corner: int, solid: int) -> str:
        return f"{describe_pose(p)}, sole of {subject.name_limb(limb)} and {names[solid]}"

    yield judge_worst(name, depth, describe_place, _describe_sole_margin(depth))


def _describe_sole_margin(depth: Array) -> str:
    """Describe the largest depth of soles."""
    return f"soles at most {max(1e3 * float(depth.max(initial=0.0)), 0.0):.2f} mm deep"


def _measure_sole_depth(subject: Subject, toes: Array, soles: Array) -> Array:
    """Return how deep corners and centres of soles are in solids (P, N, 5, S) [m]."""
    sole = subject.plan.robot.sole
    assert sole is not None
    points = toes[..., None, :] + np.concatenate(
        [compute_corner_offsets(sole, soles), np.zeros((*toes.shape[:-1], 1, 3))], axis=-2
    )
    if not subject.solids:
        return np.full((*points.shape[:-1], 1), -np.inf)
    pieces = np.stack([points, points], axis=-2)
    clearances = [
        measure_chain_distance(pieces, solid, _REPORTED_CLEARANCE)[..., 0]
        for solid in subject.solids
    ]
    return -np.stack(clearances, axis=-1)


def _measure_surface_error(subject: Subject, soles: Array) -> Array:
    """Return how far standing soles are off their surfaces or beyond their edges (K, N) [m].

    One radian of deviation from the surface's orientation counts as one metre.
    """
    plan, sole = subject.plan, subject.plan.robot.sole
    assert sole is not None
    instants = plan.instants
    error = np.linalg.norm(soles - compute_sole_axes(sole, instants.normal), axis=-1).max(axis=-1)
    points = subject.limbs.toe[..., None, :] + compute_corner_offsets(sole, soles)
    for index, surface in enumerate(plan.terrain.surfaces):
        on_surface = instants.region == index
        if not isinstance(surface, Region):
            error[on_surface] = np.inf
            continue
        normal = compute_polygon_normal(surface.vertices)
        outward, offsets = compute_polygon_edges(surface.vertices, normal)
        edge_violation = (points[on_surface] @ outward.T - offsets).max(
            axis=(-1, -2), initial=-np.inf
        )
        height_error = np.abs((points[on_surface] - surface.vertices[0]) @ normal).max(
            axis=-1, initial=0.0
        )
        error[on_surface] = np.maximum(error[on_surface], np.maximum(edge_violation, height_error))
    return np.where(instants.contact, error, -np.inf)


def judge_feet(
    name: str, subject: Subject, toes: Array, describe_pose: Callable[[int], str]
) -> Iterator[Check]:
    """Yield the check of spherical feet at toes (P, N, 3), world."""
    foot, terrain = subject.plan.robot.foot, subject.plan.terrain
    if foot is None:
        return
    sufficient = foot.radius + _REPORTED_CLEARANCE
    points = np.stack([toes, toes], axis=-2)
    names = [solid.name for solid in subject.solids]
    clearances = [
        measure_chain_distance(points, solid, sufficient)[..., 0] for solid in subject.solids
    ]
    for surface in terrain.surfaces:
        if isinstance(surface, Tube):
            names.append(surface.name)
            distance = np.linalg.norm(toes[..., :2] - surface.center, axis=-1)
            clearances.append(surface.wall - distance)
    if terrain.scan is not None:  # which regions lie so near, at most
        unique_toes, inverse = np.unique(toes.reshape(-1, 3), axis=0, return_inverse=True)
        distance = measure_triangle_distances(
            unique_toes, unique_toes, terrain.scan.corners, sufficient
        )[inverse.reshape(-1)]
        names.append("the scan")
        clearances.append(distance.reshape(toes.shape[:-1]) + terrain.scan.flatness)
    if not clearances:
        yield judge_worst(name, np.zeros(1), lambda _: "", margin="nothing is solid")
        return
    min_clearance = np.stack(clearances, axis=-1)

    def describe_place(p: int, limb: int, solid: int) -> str:
        return f"{describe_pose(p)}, foot of {subject.name_limb(limb)} and {names[solid]}"

    max_depth = max(-1e3 * float((min_clearance - foot.radius).min()), 0.0)
    margin = f"feet of {1e3 * foot.radius:.0f} mm at most {max_depth:.2f} mm deep"
    yield judge_worst(name, foot.radius - min_clearance, describe_place, margin)
