"""Positions of toes in the collision geometry of the last bodies of their legs.

A toe is the point that touches a surface, or the centre of a spherical foot. A point deeper inside
the collision geometry would touch before it is where the plan has it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.robots.urdf.shapes import CollisionShape
from climbplan.schema.document import Finding

TOLERANCE = 1e-3  # [m] between a toe and the surface of its collision geometry
_OUTSIDE = -np.inf


def find_buried_toes(
    urdf_model: UrdfModel, legs: Sequence[LegAtZero], toes: Array, shapes: list[CollisionShape]
) -> list[Finding]:
    """Return a finding for every toe deeper in its collision geometry than its foot is thick.

    Args:
        urdf_model: The robot, whose section says which link each toe is on.
        legs: N legs at zero angles.
        toes: (N, 3) points that touch, or centres of spherical feet, at zero angles, base frame
            turned to x right, y forward, z up [m].
        shapes: All collision geometry; empty where none is read.
    """
    robot, findings = urdf_model.robot, []
    radius = robot.spec.foot_radius
    for name, leg, toe in zip(robot.limb_names, legs, toes, strict=True):
        toe_shapes = select_shapes_at_toe(urdf_model, leg, robot.spec.legs[name].toe, shapes)
        depth = compute_depth(toe_shapes, toe)
        if depth <= radius + TOLERANCE:
            continue
        within = f"its foot of radius {radius:g} m" if radius else "1 mm of its surface"
        direction = _compute_leg_direction(leg, toe)
        outside = toe + compute_exit_distance(toe_shapes, toe, direction) * direction
        offset = compute_offset_in_link(urdf_model, robot.spec.legs[name].toe, outside)
        message = (
            f"the toe lies {1e3 * depth:.1f} mm inside the collision geometry of the last link "
            f"({_describe_links(urdf_model, toe_shapes)}), which touches that much earlier; "
            f"expected it within {within}: `foot: {{radius: {depth:.4g}}}` for an end that is a "
            "sphere round the toe, or "
            f"`toe_offset: [{offset[0]:g}, {offset[1]:g}, {offset[2]:g}]` on the surface"
        )
        stated = any(robot.spec.legs[name].toe_offset)
        findings.append(Finding(("legs", name, "toe_offset" if stated else "toe"), message))
    return findings


def select_shapes_at_toe(
    urdf_model: UrdfModel, leg: LegAtZero, link: str, shapes: Sequence[CollisionShape]
) -> list[CollisionShape]:
    """Return the collision geometry of a leg's last body, up to the link that its toe is on.

    Links beyond a locked joint, such as a folded hand, count only where the toe is on them.
    """
    pin, model = urdf_model.library, urdf_model.model
    index = int(model.frames[int(model.getFrameId(link, pin.FrameType.BODY))].parentJoint)
    bodies = {leg.names[-1]}
    while index > 1 and str(model.names[index]) != leg.names[-1]:
        bodies.add(str(model.names[index]))
        index = int(model.parents[index])
    return [shape for shape in shapes if shape.joint == leg.names[-1] and shape.body in bodies]


def evaluate_support(shape: CollisionShape, directions: Array) -> Array:
    """Return how far a shape reaches along unit directions (D, 3), as (D,) [m]."""
    if shape.axis is not None and shape.is_cylinder:
        middle, half, square = shape.axis
        length = float(np.linalg.norm(half))
        along = directions @ (half / length)
        across = np.sqrt(np.maximum(1.0 - along**2, 0.0))
        return np.asarray(directions @ middle + length * np.abs(along) + np.sqrt(square) * across)
    return np.asarray((directions @ shape.points.T).max(axis=1) + shape.radius)


def compute_depth(shapes: Sequence[CollisionShape], point: Array) -> float:
    """Return how deep a point (3,) lies in the deepest shape [m]; negative outside of all.

    Meshes are their convex hulls. Outside of a hull the magnitude is a lower bound of the distance.
    """
    return max((_compute_shape_depth(shape, point) for shape in shapes), default=_OUTSIDE)


def compute_exit_distance(
    shapes: Sequence[CollisionShape], start: Array, direction: Array
) -> float:
    """Return how far from `start` (3,) a ray leaves the last shape that it meets [m].

    direction: (3,) unit. Zero where it meets none ahead.
    """
    return max((_compute_shape_exit(shape, start, direction) for shape in shapes), default=0.0)


def find_nearest_point(shape: CollisionShape, point: Array) -> Array:
    """Return the point (3,) of a shape's surface nearest to a point (3,) outside of it."""
    # Least squares over convex combinations of the points, whose sum a heavy row makes one
    heavy = 1e3 * max(float(np.abs(shape.points - point).max()), 1e-3)
    rows = np.vstack([(shape.points - point).T, np.full(len(shape.points), heavy)])
    weights, _ = nnls(rows, np.array([0.0, 0.0, 0.0, heavy]))
    nearest = shape.points.T @ (weights / weights.sum())
    distance = float(np.linalg.norm(point - nearest))
    return np.asarray(
        nearest if distance == 0 else nearest + shape.radius * (point - nearest) / distance
    )


def compute_offset_in_link(
    urdf_model: UrdfModel, link: str, point: Array
) -> tuple[float, float, float]:
    """Return a point (3,) of the turned base frame in a link's frame [m], at zero angles."""
    pin, model = urdf_model.library, urdf_model.model
    data = model.createData()
    pin.forwardKinematics(model, data, urdf_model.build_configuration({}))
    pin.updateFramePlacements(model, data)
    place = data.oMf[int(model.getFrameId(link, pin.FrameType.BODY))]
    root_point = point @ urdf_model.root_to_base_rotation + urdf_model.base_origin
    x, y, z = (
        round(float(value), 4) + 0.0
        for value in place.rotation.T @ (root_point - place.translation)
    )
    return x, y, z


def _compute_leg_direction(leg: LegAtZero, toe: Array) -> Array:
    """Return the unit direction from the last joint to the toe."""
    direction = toe - leg.joints[-1]
    length = float(np.linalg.norm(direction))
    return np.asarray(direction / length) if length > 0 else np.array([0.0, 0.0, -1.0])


def _describe_links(urdf_model: UrdfModel, shapes: Sequence[CollisionShape]) -> str:
    """Return links with collision geometry among those that move with shapes, with their lines."""
    bodies, tree = {shape.body for shape in shapes}, urdf_model.robot.tree
    joint_by_child, names = tree.by_child, []
    for link in tree.links.values():
        joint = joint_by_child.get(link.name)
        while joint is not None and joint.kind == "fixed":
            joint = joint_by_child.get(joint.parent)
        if link.has_collision and joint is not None and joint.name in bodies:
            names.append(f"{link.name!r}, {tree.format_location(link.line)}")
    return "; ".join(names[:2]) or "of the last joint"


def _compute_shape_depth(shape: CollisionShape, point: Array) -> float:
    """Return how deep a point (3,) lies in one shape [m]; negative outside."""
    if len(shape.points) <= 2:  # a sphere or a capsule
        first, last = shape.points[[0, -1]]
        axis = last - first
        square = float(axis @ axis)
        fraction = min(max(float((point - first) @ axis) / square, 0.0), 1.0) if square > 0 else 0.0
        return shape.radius - float(np.linalg.norm(point - first - fraction * axis))
    if shape.axis is not None and shape.is_cylinder:
        middle, half, square = shape.axis
        length = float(np.linalg.norm(half))
        height = float((point - middle) @ half) / length
        distance = float(np.linalg.norm(point - middle - height * half / length))
        return float(min(np.sqrt(square) - distance, length - abs(height)))
    faces = _compute_faces(shape)
    if faces is None:
        return _OUTSIDE
    return float(-(faces[:, :3] @ point + faces[:, 3]).max())


def _compute_shape_exit(shape: CollisionShape, start: Array, direction: Array) -> float:
    """Return the distance at which a ray leaves one shape [m]; 0 if it does not meet it."""
    if len(shape.points) <= 2:
        # The last of the spheres at its ends and of the tube between them
        return max(_compute_sphere_exit(p, shape.radius, start, direction) for p in shape.points)
    if shape.axis is not None and shape.is_cylinder:
        return _compute_cylinder_exit(*shape.axis, start, direction)
    faces = _compute_faces(shape)
    if faces is None:
        return 0.0
    speed, clearance = faces[:, :3] @ direction, -(faces[:, :3] @ start + faces[:, 3])
    return _compute_plane_exit(speed, clearance)


def _compute_plane_exit(speed: Array, clearance: Array) -> float:
    """Return the distance at which a ray leaves half-spaces, from its speeds and clearances."""
    if (clearance[np.abs(speed) < 1e-12] < 0).any():
        return 0.0
    leaving, entering = speed > 1e-12, speed < -1e-12
    last = float((clearance[leaving] / speed[leaving]).min(initial=np.inf))
    first = float((clearance[entering] / speed[entering]).max(initial=-np.inf))
    return last if first <= last and np.isfinite(last) else 0.0


def _compute_cylinder_exit(
    middle: Array, half: Array, square: float, start: Array, direction: Array
) -> float:
    """Return the distance at which a ray leaves a cylinder [m]; 0 if it does not meet it."""
    length = float(np.linalg.norm(half))
    axis, offset = half / length, start - middle
    height, rising = float(offset @ axis), float(direction @ axis)
    caps = _compute_plane_exit(
        np.array([rising, -rising]), np.array([length - height, length + height])
    )
    radial, radial_speed = offset - height * axis, direction - rising * axis
    a, b, c = (
        float(radial_speed @ radial_speed),
        float(radial @ radial_speed),
        float(radial @ radial) - square,
    )
    if a < 1e-12:  # along the axis
        return caps if c <= 0 else 0.0
    discriminant = b * b - a * c
    if discriminant < 0:
        return 0.0
    wall = (-b + float(np.sqrt(discriminant))) / a
    return min(caps, wall) if abs(rising) > 1e-12 else wall


def _compute_sphere_exit(centre: Array, radius: float, start: Array, direction: Array) -> float:
    """Return the distance at which a ray leaves a sphere [m]; 0 if it does not meet it."""
    along = float((centre - start) @ direction)
    discriminant = radius**2 - float((centre - start) @ (centre - start)) + along**2
    return along + float(np.sqrt(discriminant)) if discriminant >= 0 else 0.0


def _compute_faces(shape: CollisionShape) -> Array | None:
    """Return outward normals and offsets (F, 4) of a shape's hull; None without volume."""
    try:
        return np.asarray(ConvexHull(shape.points).equations)
    except (QhullError, ValueError):
        return None
