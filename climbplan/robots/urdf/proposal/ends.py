"""Toes on the surface of the collision geometry that legs end in, or in the centre of its end.

The support function of a body, how far it reaches along a unit direction d, is c d + r for a sphere
of centre c and radius r. Where that fits the end of a last body in all directions within 45 degrees
of the leg's own, its foot is that sphere; elsewhere a toe is the point at which the line from the
last joint through it leaves the body.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.proposal.toes import Toe, toe_at
from climbplan.robots.urdf.shapes import Shape
from climbplan.robots.urdf.toe_surface import (
    TOLERANCE,
    depth_in,
    exit_distance,
    nearest_point,
    shapes_at_toe,
    support_of,
)

_CONE = np.deg2rad(45.0)  # about the leg's direction, in which its end may touch a surface
_DIRECTIONS = 300  # within the cone
_ROUND = 0.1  # of the radius, by which the end of a foot may differ from a sphere, but
_ROUND_LEAST, _ROUND_MOST = 1.5e-3, 2.5e-3  # [m]
_ALIKE = 1e-3  # [m] by which radii of feet may differ
_SMALLEST = 1e-3  # [m] of a radius
_ON_SURFACE = 2e-4  # [m] off the surface, up to which a toe is left where it is
_TIED = 1e-4  # [m] within which points are equally near


def ends_of(
    found: UrdfModel, names: Sequence[str], toes: list[Toe], shapes: list[Shape]
) -> tuple[list[Toe], float]:
    """Return toes moved to where their legs touch, and the radius of spherical feet [m], or 0.

    Args:
        found: the robot with its legs.
        names: legs, N of them.
        toes: (N,) as they are found by names and frames.
        shapes: all collision geometry; legs without any keep their toes.
    """
    legs = [found.leg(name) for name in names]
    own = [_touching(found, leg, toe, shapes) for leg, toe in zip(legs, toes, strict=True)]
    balls = [_ball(leg, parts) for leg, parts in zip(legs, own, strict=True)]
    spheres = [ball for ball in balls if ball is not None]
    radii = [radius for _, radius in spheres]
    if len(spheres) == len(toes) and max(radii) - min(radii) <= _ALIKE:
        radius = round(float(np.mean(radii)), 4)
        centred = [
            toe_at(
                found,
                toe.link,
                centre + (own_radius - radius) * _outward(leg),
                f"{toe.why}; the centre of the sphere that fits its end",
            )
            for toe, leg, (centre, own_radius) in zip(toes, legs, spheres, strict=True)
        ]
        return centred, radius
    moved = [
        _on_surface(found, leg, toe, parts) for leg, toe, parts in zip(legs, toes, own, strict=True)
    ]
    return moved, 0.0


def _touching(found: UrdfModel, leg: LegAtZero, toe: Toe, shapes: Sequence[Shape]) -> list[Shape]:
    """What touches at a toe: of its own links, or of held ones that it stands on, such as wheels.

    Nothing of limbs that end before weak motors: the links beyond are taken to be out of the way.
    """
    if toe.is_cut:
        return []
    own = shapes_at_toe(found, leg, toe.link, shapes)
    every = [shape for shape in shapes if shape.joint == leg.names[-1]]
    on_held = depth_in(own, leg.toe) < -TOLERANCE <= depth_in(every, leg.toe)
    return every if on_held else own


def _ball(leg: LegAtZero, shapes: list[Shape]) -> tuple[Array, float] | None:
    """Centre (3,) and radius [m] of the sphere that the end of a last body is, None of others.

    The sphere reaches exactly as far as the body along the leg, and by least squares elsewhere.
    """
    direction = _outward(leg)
    if not shapes or not direction.any():
        return None
    cone = _cone(direction)
    reach = np.max([support_of(shape, cone) for shape in shapes], axis=0)
    along = float(np.max([support_of(shape, direction[None])[0] for shape in shapes]))
    rows = cone - direction
    centre, *_ = np.linalg.lstsq(rows, reach - along, rcond=None)
    radius = along - float(centre @ direction)
    off = float(np.abs(rows @ centre - (reach - along)).max())
    length = float((centre - leg.joints[-1]) @ direction)
    if (
        off > np.clip(_ROUND * radius, _ROUND_LEAST, _ROUND_MOST)
        or not _SMALLEST <= radius < length
    ):
        return None
    return np.asarray(centre), radius


def _on_surface(found: UrdfModel, leg: LegAtZero, toe: Toe, shapes: list[Shape]) -> Toe:
    """The toe where the line from the last joint through it leaves the collision geometry.

    Where a toe is outside and that line leaves elsewhere than at the end, the nearest point of the
    surface, of several alike that nearest to the robot's middle plane.
    """
    direction = _outward(leg)
    if not shapes or not direction.any() or abs(depth_in(shapes, leg.toe)) <= _ON_SURFACE:
        return toe
    joint = leg.joints[-1]
    away = exit_distance(shapes, joint, direction)
    point = joint + away * direction
    if depth_in(shapes, leg.toe) < 0:
        reach = max(float(support_of(shape, direction[None])[0]) for shape in shapes)
        if float(point @ direction) < reach - TOLERANCE:
            near = np.array([nearest_point(shape, leg.toe) for shape in shapes])
            far = np.linalg.norm(near - leg.toe, axis=1)
            tied = near[far <= far.min() + _TIED]
            point = tied[int(np.argmin(np.abs(tied[:, 0])))]
    return toe_at(found, toe.link, point, f"{toe.why}, on the surface of its collision geometry")


def _outward(leg: LegAtZero) -> Array:
    """The unit direction from the last joint to the toe, zero where they are one point."""
    along = leg.toe - leg.joints[-1]
    length = float(np.linalg.norm(along))
    return np.asarray(along / length) if length > 0 else np.zeros(3)


def _cone(direction: Array) -> Array:
    """(D, 3) unit directions spread evenly over the cone, on a spiral."""
    number = np.arange(_DIRECTIONS) + 0.5
    high = 1 - (1 - np.cos(_CONE)) * number / _DIRECTIONS
    turn = np.pi * (1 + np.sqrt(5)) * number
    across = np.sqrt(1 - high**2)
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first = first / np.linalg.norm(first)
    second = np.cross(direction, first)
    return np.asarray(
        high[:, None] * direction
        + across[:, None] * (np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second)
    )
