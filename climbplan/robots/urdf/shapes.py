"""How thick legs are and how large the body is, from the collision geometry of a URDF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.normal_document import normal_document
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.schema.document import Finding

_FLAT = 2e-3  # [m] of a part of the body that is too thin to be in the way
_RIM = 16  # points on the rim of a cylinder


@dataclass(frozen=True)
class Shape:
    """One piece of collision geometry: what lies within `radius` of the hull of `points`."""

    joint: str  # that carries it, "" for the body
    points: Array  # (P, 3) at zero angles, base frame turned to x right, y forward, z up [m]
    radius: float  # [m]
    # of a box or a cylinder: middle (3,) and half (3,) of its long axis [m], and the square of how
    # far its edges lie from that [m^2]
    axis: tuple[Array, Array, float] | None = None
    body: str = ""  # the joint that moves it, held ones included

    @property
    def is_cylinder(self) -> bool:
        """Whether it is a cylinder, of which `points` are corners of a prism round it."""
        return self.axis is not None and len(self.points) == 2 * _RIM


def collision_shapes(found: UrdfModel) -> list[Shape]:
    """All collision geometry of a URDF.

    Raises SpecError for a mesh that cannot be read.
    """
    pin, model = found.library, found.model
    try:
        geometry = pin.buildGeomFromUrdfString(
            model, normal_document(found.robot), pin.GeometryType.COLLISION
        )
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1]
        message = f"its collision geometry cannot be read: {reason}"
        raise found.robot.refused([Finding(("urdf",), message)]) from error
    data = model.createData()
    pin.forwardKinematics(model, data, found.angles({}))
    moved = {joint.name for leg in found.robot.joints.values() for joint in leg}
    shapes = []
    for item in geometry.geometryObjects:
        points, radius = _points_of(item.geometry)
        place = data.oMi[item.parentJoint] * item.placement

        def at(own: Array, place: Any = place) -> Array:
            return found.placed(own @ place.rotation.T + place.translation)

        name = carrier(model, item.parentJoint, moved)
        axis = None
        if (long := _axis_of(item.geometry)) is not None:
            middle = at(np.zeros(3))
            axis = middle, at(long[0]) - middle, long[1]
        body = str(model.names[item.parentJoint])
        shapes.append(Shape(name, at(points), radius, axis, body))
    return shapes


def carrier(model: Any, joint: int, moved: set[str]) -> str:
    """The joint of a leg that carries a shape, past joints that are held; "" for the body."""
    while joint > 1 and model.names[joint] not in moved:
        joint = int(model.parents[joint])
    return str(model.names[joint]) if joint > 1 else ""


def body_parts(shapes: list[Shape]) -> list[Array]:
    """Corners (V, 3) of convex parts of the body, meshes and round ones as their bounding boxes."""
    out = []
    for shape in shapes:
        if shape.joint:
            continue
        if shape.axis is None:
            box = shape.points.min(axis=0) - shape.radius, shape.points.max(axis=0) + shape.radius
            upper = np.stack(np.meshgrid(*[(False, True)] * 3, indexing="ij"), axis=-1)
            out.append(np.where(upper.reshape(-1, 3), box[1], box[0]))
        else:
            out.append(shape.points)
    return [part for part in out if (np.ptp(part, axis=0) > _FLAT).all()]


def body_box(shapes: list[Shape]) -> tuple[Array, Array] | None:
    """Lower and upper corner of the body's shapes, None without any."""
    own = [s for s in shapes if not s.joint]
    if not own:
        return None
    lower = np.min([s.points.min(axis=0) - s.radius for s in own], axis=0)
    upper = np.max([s.points.max(axis=0) + s.radius for s in own], axis=0)
    return lower, upper


def _axis_of(geometry: Any) -> tuple[Array, float] | None:
    """Half of the long axis of a box or a cylinder, and the square of how far its edges lie off."""
    kind = type(geometry).__name__
    if kind == "Cylinder":
        return np.array([0.0, 0.0, float(geometry.halfLength)]), float(geometry.radius) ** 2
    if kind == "Box":
        half = np.array(geometry.halfSide, float)
        longest = np.arange(3) == int(np.argmax(half))
        return np.where(longest, half, 0.0), float((half[~longest] ** 2).sum())
    return None


def _points_of(geometry: Any) -> tuple[Array, float]:
    """Points and radius of one piece of geometry in its own frame."""
    kind = type(geometry).__name__
    if kind == "Sphere":
        return np.zeros((1, 3)), float(geometry.radius)
    if kind == "Capsule":
        half = float(geometry.halfLength)
        return np.array([[0.0, 0.0, -half], [0.0, 0.0, half]]), float(geometry.radius)
    if kind == "Cylinder":
        angle = 2 * np.pi * np.arange(_RIM) / _RIM
        # The polygon holds the circle
        radius = float(geometry.radius) / np.cos(np.pi / _RIM)
        rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        half = float(geometry.halfLength)
        ends = [np.column_stack([rim, np.full(_RIM, z)]) for z in (-half, half)]
        return np.concatenate(ends), 0.0
    if kind == "Box":
        corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1)
        return corners.reshape(-1, 3) * np.array(geometry.halfSide), 0.0
    vertices = np.array(geometry.vertices(), float).reshape(-1, 3)  # a mesh
    return vertices, 0.0
