"""Toes at the points where legs touch: on the surface of their collision geometry, or in a sphere.

The support function of a body, how far it reaches along a unit direction d, is c d + r for a sphere
of centre c and radius r. If that fits the end of a last body in all directions within 45 degrees
of the leg's own, its foot is that sphere. Elsewhere a toe is the point at which the line from the
last joint through it leaves the body.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.proposal.toes import Toe, build_toe
from climbplan.robots.urdf.shapes import CollisionShape
from climbplan.robots.urdf.toe_surface import (
    TOLERANCE,
    compute_depth,
    compute_exit_distance,
    evaluate_support,
    find_nearest_point,
    select_shapes_at_toe,
)

_CONE_ANGLE = np.deg2rad(45.0)  # half angle about the leg, in which its end may touch
_NUM_DIRECTIONS = 300  # within the cone
_MAX_SPHERE_ERROR = 0.1  # of the radius, of the end of a foot from a sphere, but within
_MIN_SPHERE_TOLERANCE, _MAX_SPHERE_TOLERANCE = 1.5e-3, 2.5e-3  # [m]
_RADIUS_TOLERANCE = 1e-3  # [m] between radii of feet
_MIN_RADIUS = 1e-3  # [m] of a radius
_SURFACE_TOLERANCE = 2e-4  # [m] off the surface, up to which a toe stays where it is
_TIE_TOLERANCE = 1e-4  # [m] within which points are equally near


def place_toes_on_surface(
    urdf_model: UrdfModel, names: Sequence[str], toes: list[Toe], shapes: list[CollisionShape]
) -> tuple[list[Toe], float]:
    """Return toes moved to where their legs touch, and the radius of spherical feet [m], or 0.

    Args:
        urdf_model: The robot with its legs.
        names: Legs, N of them.
        toes: (N,) toes by names and frames.
        shapes: All collision geometry; legs without any keep their toes.
    """
    legs = [urdf_model.read_leg(name) for name in names]
    touching = [
        _select_touching_shapes(urdf_model, leg, toe, shapes)
        for leg, toe in zip(legs, toes, strict=True)
    ]
    fits = [
        _fit_end_sphere(leg, toe_shapes) for leg, toe_shapes in zip(legs, touching, strict=True)
    ]
    spheres = [fit for fit in fits if fit is not None]
    radii = [radius for _, radius in spheres]
    if len(spheres) == len(toes) and max(radii) - min(radii) <= _RADIUS_TOLERANCE:
        radius = round(float(np.mean(radii)), 4)
        centred = [
            build_toe(
                urdf_model,
                toe.link,
                centre + (fitted_radius - radius) * _compute_leg_direction(leg),
                f"{toe.reason}; the centre of the sphere that fits its end",
            )
            for toe, leg, (centre, fitted_radius) in zip(toes, legs, spheres, strict=True)
        ]
        return centred, radius
    moved_toes = [
        _move_to_surface(urdf_model, leg, toe, toe_shapes)
        for leg, toe, toe_shapes in zip(legs, toes, touching, strict=True)
    ]
    return moved_toes, 0.0


def _select_touching_shapes(
    urdf_model: UrdfModel, leg: LegAtZero, toe: Toe, shapes: Sequence[CollisionShape]
) -> list[CollisionShape]:
    """Return what touches at a toe: its own links, or locked ones under it, such as wheels.

    Nothing for limbs that end before weak motors: the links beyond are taken to be out of the way.
    """
    if toe.is_truncated:
        return []
    toe_shapes = select_shapes_at_toe(urdf_model, leg, toe.link, shapes)
    leg_shapes = [shape for shape in shapes if shape.joint == leg.names[-1]]
    is_on_locked = (
        compute_depth(toe_shapes, leg.toe) < -TOLERANCE <= compute_depth(leg_shapes, leg.toe)
    )
    return leg_shapes if is_on_locked else toe_shapes


def _fit_end_sphere(leg: LegAtZero, shapes: list[CollisionShape]) -> tuple[Array, float] | None:
    """Return centre (3,) and radius [m] of the sphere at the end of a last body; None without one.

    The sphere reaches exactly as far as the body along the leg, and by least squares elsewhere.
    """
    direction = _compute_leg_direction(leg)
    if not shapes or not direction.any():
        return None
    cone = _sample_cone(direction)
    reach = np.max([evaluate_support(shape, cone) for shape in shapes], axis=0)
    reach_along = float(np.max([evaluate_support(shape, direction[None])[0] for shape in shapes]))
    rows = cone - direction
    centre, *_ = np.linalg.lstsq(rows, reach - reach_along, rcond=None)
    radius = reach_along - float(centre @ direction)
    error = float(np.abs(rows @ centre - (reach - reach_along)).max())
    length = float((centre - leg.joints[-1]) @ direction)
    if (
        error > np.clip(_MAX_SPHERE_ERROR * radius, _MIN_SPHERE_TOLERANCE, _MAX_SPHERE_TOLERANCE)
        or not _MIN_RADIUS <= radius < length
    ):
        return None
    return np.asarray(centre), radius


def _move_to_surface(
    urdf_model: UrdfModel, leg: LegAtZero, toe: Toe, shapes: list[CollisionShape]
) -> Toe:
    """Return the toe where the line from the last joint through it leaves the collision geometry.

    If a toe is outside and that line leaves elsewhere than at the end, it is the nearest point of
    the surface; of equally near ones, the nearest to the robot's middle plane.
    """
    direction = _compute_leg_direction(leg)
    if (
        not shapes
        or not direction.any()
        or abs(compute_depth(shapes, leg.toe)) <= _SURFACE_TOLERANCE
    ):
        return toe
    joint = leg.joints[-1]
    distance = compute_exit_distance(shapes, joint, direction)
    point = joint + distance * direction
    if compute_depth(shapes, leg.toe) < 0:
        reach = max(float(evaluate_support(shape, direction[None])[0]) for shape in shapes)
        if float(point @ direction) < reach - TOLERANCE:
            nearest = np.array([find_nearest_point(shape, leg.toe) for shape in shapes])
            distances = np.linalg.norm(nearest - leg.toe, axis=1)
            tied = nearest[distances <= distances.min() + _TIE_TOLERANCE]
            point = tied[int(np.argmin(np.abs(tied[:, 0])))]
    return build_toe(
        urdf_model, toe.link, point, f"{toe.reason}, on the surface of its collision geometry"
    )


def _compute_leg_direction(leg: LegAtZero) -> Array:
    """Return the unit direction from the last joint to the toe, zero where they coincide."""
    direction = leg.toe - leg.joints[-1]
    length = float(np.linalg.norm(direction))
    return np.asarray(direction / length) if length > 0 else np.zeros(3)


def _sample_cone(direction: Array) -> Array:
    """Return unit directions (D, 3) spread evenly over the cone, on a spiral."""
    index = np.arange(_NUM_DIRECTIONS) + 0.5
    height = 1 - (1 - np.cos(_CONE_ANGLE)) * index / _NUM_DIRECTIONS
    azimuth = np.pi * (1 + np.sqrt(5)) * index
    radius = np.sqrt(1 - height**2)
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first = first / np.linalg.norm(first)
    second = np.cross(direction, first)
    return np.asarray(
        height[:, None] * direction
        + radius[:, None] * (np.cos(azimuth)[:, None] * first + np.sin(azimuth)[:, None] * second)
    )
