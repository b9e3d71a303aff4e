"""Collision geometry of a URDF: how thick its legs are, and how large its body is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.canonical_urdf import write_canonical_urdf
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.schema.document import Finding

_MIN_THICKNESS = 2e-3  # [m] of a part of the body: thinner ones are ignored
_NUM_RIM_POINTS = 16  # of a cylinder


@dataclass(frozen=True)
class CollisionShape:
    """One piece of collision geometry: what lies within `radius` of the hull of `points`."""

    joint: str  # that carries it, "" for the body
    points: Array  # (P, 3) at zero angles, base frame turned to x right, y forward, z up [m]
    radius: float  # [m]
    # of a box or a cylinder: middle (3,) and half (3,) of its long axis [m], and the squared
    # distance of its edges from that axis [m^2]
    axis: tuple[Array, Array, float] | None = None
    body: str = ""  # the joint that moves it, locked ones included

    @property
    def is_cylinder(self) -> bool:
        """True for a cylinder, of which `points` are corners of a prism around it."""
        return self.axis is not None and len(self.points) == 2 * _NUM_RIM_POINTS


def read_collision_shapes(urdf_model: UrdfModel) -> list[CollisionShape]:
    """Read all collision geometry of a URDF.

    Raises:
        SpecError: A mesh cannot be read.
    """
    pin, model = urdf_model.library, urdf_model.model
    try:
        geometry = pin.buildGeomFromUrdfString(
            model, write_canonical_urdf(urdf_model.robot), pin.GeometryType.COLLISION
        )
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1]
        message = f"its collision geometry cannot be read: {reason}"
        raise urdf_model.robot.build_error([Finding(("urdf",), message)]) from error
    data = model.createData()
    pin.forwardKinematics(model, data, urdf_model.build_configuration({}))
    leg_joints = {joint.name for leg in urdf_model.robot.joints.values() for joint in leg}
    shapes = []
    for item in geometry.geometryObjects:
        points, radius = _build_points(item.geometry)
        place = data.oMi[item.parentJoint] * item.placement

        def to_base(local: Array, place: Any = place) -> Array:
            return urdf_model.to_base_axes(local @ place.rotation.T + place.translation)

        name = find_carrying_joint(model, item.parentJoint, leg_joints)
        axis = None
        if (long_axis := _compute_long_axis(item.geometry)) is not None:
            middle = to_base(np.zeros(3))
            axis = middle, to_base(long_axis[0]) - middle, long_axis[1]
        body = str(model.names[item.parentJoint])
        shapes.append(CollisionShape(name, to_base(points), radius, axis, body))
    return shapes


def find_carrying_joint(model: Any, joint: int, leg_joints: set[str]) -> str:
    """Return the joint of a leg that carries a shape, past locked joints; "" for the body.

    Args:
        model: The Pinocchio model.
        joint: Index of the joint that moves the shape.
        leg_joints: Names of the joints of legs.
    """
    while joint > 1 and model.names[joint] not in leg_joints:
        joint = int(model.parents[joint])
    return str(model.names[joint]) if joint > 1 else ""


def build_body_parts(shapes: list[CollisionShape]) -> list[Array]:
    """Return corners (V, 3) of convex parts of the body [m].

    Meshes and round shapes are replaced by their bounding boxes, thin parts left out.
    """
    boxes = []
    for shape in shapes:
        if shape.joint:
            continue
        if shape.axis is None:
            box = shape.points.min(axis=0) - shape.radius, shape.points.max(axis=0) + shape.radius
            upper = np.stack(np.meshgrid(*[(False, True)] * 3, indexing="ij"), axis=-1)
            boxes.append(np.where(upper.reshape(-1, 3), box[1], box[0]))
        else:
            boxes.append(shape.points)
    return [
        box_corners for box_corners in boxes if (np.ptp(box_corners, axis=0) > _MIN_THICKNESS).all()
    ]


def compute_body_box(shapes: list[CollisionShape]) -> tuple[Array, Array] | None:
    """Return the lower and upper corner of the body's shapes [m], None without any."""
    body_shapes = [s for s in shapes if not s.joint]
    if not body_shapes:
        return None
    lower = np.min([s.points.min(axis=0) - s.radius for s in body_shapes], axis=0)
    upper = np.max([s.points.max(axis=0) + s.radius for s in body_shapes], axis=0)
    return lower, upper


def _compute_long_axis(geometry: Any) -> tuple[Array, float] | None:
    """Return half of the long axis of a box or cylinder, and the squared distance of its edges."""
    kind = type(geometry).__name__
    if kind == "Cylinder":
        return np.array([0.0, 0.0, float(geometry.halfLength)]), float(geometry.radius) ** 2
    if kind == "Box":
        half = np.array(geometry.halfSide, float)
        longest = np.arange(3) == int(np.argmax(half))
        return np.where(longest, half, 0.0), float((half[~longest] ** 2).sum())
    return None


def _build_points(geometry: Any) -> tuple[Array, float]:
    """Return points and radius of one piece of geometry in its own frame."""
    kind = type(geometry).__name__
    if kind == "Sphere":
        return np.zeros((1, 3)), float(geometry.radius)
    if kind == "Capsule":
        half = float(geometry.halfLength)
        return np.array([[0.0, 0.0, -half], [0.0, 0.0, half]]), float(geometry.radius)
    if kind == "Cylinder":
        angle = 2 * np.pi * np.arange(_NUM_RIM_POINTS) / _NUM_RIM_POINTS
        # The polygon holds the circle
        radius = float(geometry.radius) / np.cos(np.pi / _NUM_RIM_POINTS)
        rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        half = float(geometry.halfLength)
        ends = [np.column_stack([rim, np.full(_NUM_RIM_POINTS, z)]) for z in (-half, half)]
        return np.concatenate(ends), 0.0
    if kind == "Box":
        corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1)
        return corners.reshape(-1, 3) * np.array(geometry.halfSide), 0.0
    vertices = np.array(geometry.vertices(), float).reshape(-1, 3)  # a mesh
    return vertices, 0.0
