"""Where toes lie in the collision geometry of the last bodies of their legs.

A toe is the point that touches a surface, or the centre of a spherical foot. A point deeper than
that inside the collision geometry would touch before it is where the plan has it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.shapes import Shape
from climbplan.schema.document import Finding

TOLERANCE = 1e-3  # [m] between a toe and the surface of its collision geometry
_OUTSIDE = -np.inf


def buried_toes(
    found: UrdfModel, legs: Sequence[LegAtZero], toes: Array, shapes: list[Shape]
) -> list[Finding]:
    """Return a finding for every toe deeper in its collision geometry than its foot is thick.

    Args:
        found: the robot, whose section says which link each toe is on.
        legs: N legs at zero angles.
        toes: (N, 3) points that touch, or centres of spherical feet, at zero angles, base frame
            turned to x right, y forward, z up [m].
        shapes: all collision geometry; empty where none is read.
    """
    robot, findings = found.robot, []
    radius = robot.spec.foot_radius
    for name, leg, toe in zip(robot.limb_names, legs, toes, strict=True):
        own = shapes_at_toe(found, leg, robot.spec.legs[name].toe, shapes)
        depth = depth_in(own, toe)
        if depth <= radius + TOLERANCE:
            continue
        within = f"its foot of radius {radius:g} m" if radius else "1 mm of its surface"
        outside = toe + exit_distance(own, toe, _outward(leg, toe)) * _outward(leg, toe)
        place = offset_in_link(found, robot.spec.legs[name].toe, outside)
        message = (
            f"the toe lies {1e3 * depth:.1f} mm inside the collision geometry of the last link "
            f"({_links_of(found, own)}), which touches that much earlier; expected it within "
            f"{within}: `foot: {{radius: {depth:.4g}}}` for an end that is a sphere round the toe, "
            f"or `toe_offset: [{place[0]:g}, {place[1]:g}, {place[2]:g}]` on the surface"
        )
        stated = any(robot.spec.legs[name].toe_offset)
        findings.append(Finding(("legs", name, "toe_offset" if stated else "toe"), message))
    return findings


def shapes_at_toe(
    found: UrdfModel, leg: LegAtZero, link: str, shapes: Sequence[Shape]
) -> list[Shape]:
    """Return the collision geometry of a leg's last body, up to the link that its toe is on.

    Links beyond a held joint, such as a folded hand, count only where the toe is on them.
    """
    pin, model = found.library, found.model
    index = int(model.frames[int(model.getFrameId(link, pin.FrameType.BODY))].parentJoint)
    bodies = {leg.names[-1]}
    while index > 1 and str(model.names[index]) != leg.names[-1]:
        bodies.add(str(model.names[index]))
        index = int(model.parents[index])
    return [s for s in shapes if s.joint == leg.names[-1] and s.body in bodies]


def support_of(shape: Shape, directions: Array) -> Array:
    """Return how far a shape reaches along unit directions (D, 3), as (D,) [m]."""
    if shape.axis is not None and shape.is_cylinder:
        middle, half, square = shape.axis
        length = float(np.linalg.norm(half))
        along = directions @ (half / length)
        across = np.sqrt(np.maximum(1.0 - along**2, 0.0))
        return np.asarray(directions @ middle + length * np.abs(along) + np.sqrt(square) * across)
    return np.asarray((directions @ shape.points.T).max(axis=1) + shape.radius)


def depth_in(shapes: Sequence[Shape], point: Array) -> float:
    """Return how deep a point (3,) lies in the deepest shape [m]; negative outside of all.

    Meshes are their convex hulls. Outside of a hull the magnitude is a lower bound of the distance.
    """
    return max((_depth(shape, point) for shape in shapes), default=_OUTSIDE)


def exit_distance(shapes: Sequence[Shape], start: Array, direction: Array) -> float:
    """Return how far from `start` (3,) a ray leaves the last shape that it meets [m].

    direction: (3,) unit. Zero where it meets none ahead.
    """
    return max((_exit(shape, start, direction) for shape in shapes), default=0.0)


def nearest_point(shape: Shape, point: Array) -> Array:
    """Return the point (3,) of a shape's surface nearest to a point (3,) outside of it."""
    # Least squares over convex combinations of the points, whose sum a heavy row makes one
    heavy = 1e3 * max(float(np.abs(shape.points - point).max()), 1e-3)
    rows = np.vstack([(shape.points - point).T, np.full(len(shape.points), heavy)])
    parts, _ = nnls(rows, np.array([0.0, 0.0, 0.0, heavy]))
    inner = shape.points.T @ (parts / parts.sum())
    away = float(np.linalg.norm(point - inner))
    return np.asarray(inner if away == 0 else inner + shape.radius * (point - inner) / away)


def offset_in_link(found: UrdfModel, link: str, point: Array) -> tuple[float, float, float]:
    """Return a point (3,) of the turned base frame in a link's frame [m], at zero angles."""
    pin, model = found.library, found.model
    data = model.createData()
    pin.forwardKinematics(model, data, found.angles({}))
    pin.updateFramePlacements(model, data)
    place = data.oMf[int(model.getFrameId(link, pin.FrameType.BODY))]
    root = point @ found.turn + found.origin
    x, y, z = (
        round(float(value), 4) + 0.0 for value in place.rotation.T @ (root - place.translation)
    )
    return x, y, z


def _outward(leg: LegAtZero, toe: Array) -> Array:
    """The unit direction from the last joint to the toe."""
    along = toe - leg.joints[-1]
    length = float(np.linalg.norm(along))
    return np.asarray(along / length) if length > 0 else np.array([0.0, 0.0, -1.0])


def _links_of(found: UrdfModel, shapes: Sequence[Shape]) -> str:
    """Links with collision geometry among those that joints of shapes move, with their lines."""
    bodies, tree = {shape.body for shape in shapes}, found.robot.tree
    carried, names = tree.by_child, []
    for link in tree.links.values():
        joint = carried.get(link.name)
        while joint is not None and joint.kind == "fixed":
            joint = carried.get(joint.parent)
        if link.has_collision and joint is not None and joint.name in bodies:
            names.append(f"{link.name!r}, {tree.at(link.line)}")
    return "; ".join(names[:2]) or "of the last joint"


def _depth(shape: Shape, point: Array) -> float:
    if len(shape.points) <= 2:  # a sphere or a capsule
        first, last = shape.points[[0, -1]]
        along = last - first
        square = float(along @ along)
        part = min(max(float((point - first) @ along) / square, 0.0), 1.0) if square > 0 else 0.0
        return shape.radius - float(np.linalg.norm(point - first - part * along))
    if shape.axis is not None and shape.is_cylinder:
        middle, half, square = shape.axis
        length = float(np.linalg.norm(half))
        high = float((point - middle) @ half) / length
        away = float(np.linalg.norm(point - middle - high * half / length))
        return float(min(np.sqrt(square) - away, length - abs(high)))
    faces = _faces(shape)
    if faces is None:
        return _OUTSIDE
    return float(-(faces[:, :3] @ point + faces[:, 3]).max())


def _exit(shape: Shape, start: Array, direction: Array) -> float:
    if len(shape.points) <= 2:
        # The last of the spheres at its ends and of the tube between them
        return max(_exit_of_sphere(p, shape.radius, start, direction) for p in shape.points)
    if shape.axis is not None and shape.is_cylinder:
        return _exit_of_cylinder(*shape.axis, start, direction)
    faces = _faces(shape)
    if faces is None:
        return 0.0
    speed, room = faces[:, :3] @ direction, -(faces[:, :3] @ start + faces[:, 3])
    return _exit_of_planes(speed, room)


def _exit_of_planes(speed: Array, room: Array) -> float:
    """Distance at which a ray leaves half-spaces, by its speed towards them and room to them."""
    if (room[np.abs(speed) < 1e-12] < 0).any():
        return 0.0
    out, into = speed > 1e-12, speed < -1e-12
    last = float((room[out] / speed[out]).min(initial=np.inf))
    first = float((room[into] / speed[into]).max(initial=-np.inf))
    return last if first <= last and np.isfinite(last) else 0.0


def _exit_of_cylinder(
    middle: Array, half: Array, square: float, start: Array, direction: Array
) -> float:
    length = float(np.linalg.norm(half))
    axis, here = half / length, start - middle
    high, rising = float(here @ axis), float(direction @ axis)
    caps = _exit_of_planes(np.array([rising, -rising]), np.array([length - high, length + high]))
    aside, moving = here - high * axis, direction - rising * axis
    a, b, c = float(moving @ moving), float(aside @ moving), float(aside @ aside) - square
    if a < 1e-12:  # along the axis
        return caps if c <= 0 else 0.0
    inside = b * b - a * c
    if inside < 0:
        return 0.0
    wall = (-b + float(np.sqrt(inside))) / a
    return min(caps, wall) if abs(rising) > 1e-12 else wall


def _exit_of_sphere(centre: Array, radius: float, start: Array, direction: Array) -> float:
    along = float((centre - start) @ direction)
    inside = radius**2 - float((centre - start) @ (centre - start)) + along**2
    return along + float(np.sqrt(inside)) if inside >= 0 else 0.0


def _faces(shape: Shape) -> Array | None:
    """(F, 4) outward normals and offsets of a shape's hull; None of one without volume."""
    try:
        return np.asarray(ConvexHull(shape.points).equations)
    except (QhullError, ValueError):
        return None
