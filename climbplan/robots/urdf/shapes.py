"""How thick legs are and how large the body is, from the collision geometry of a URDF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.robots.urdf.normal_document import normal_document
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel
from climbplan.spec.document import Finding

_RIM = 16  # points on the rim of a cylinder


@dataclass(frozen=True)
class Shape:
    """One piece of collision geometry: what lies within `radius` of the hull of `points`."""

    joint: str  # that carries it, "" for the body
    points: Array  # (P, 3) at zero angles, base frame turned to x right, y forward, z up [m]
    radius: float  # [m]


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
        at = points @ place.rotation.T + place.translation
        name = _carrier(model, item.parentJoint, moved)
        shapes.append(Shape(name, found.placed(at), radius))
    return shapes


def _carrier(model: Any, joint: int, moved: set[str]) -> str:
    """The joint of a leg that carries a shape, past joints that are held; "" for the body."""
    while joint > 1 and model.names[joint] not in moved:
        joint = int(model.parents[joint])
    return str(model.names[joint]) if joint > 1 else ""


def legs_radius(legs: list[LegAtZero], shapes: list[Shape]) -> float | None:
    """Radius [m] of capsules round the links that hold the legs' shapes; None without any.

    A link is the straight piece from its joint to the next, the last one to the toe.
    """
    reach = 0.0
    found = False
    for leg in legs:
        ends = np.concatenate([leg.joints, leg.toe[None]])
        for index, joint in enumerate(leg.names):
            for shape in (s for s in shapes if s.joint == joint):
                found = True
                away = _off_segment(shape.points, ends[index], ends[index + 1])
                reach = max(reach, float(away.max()) + shape.radius)
    return reach if found else None


def body_box(shapes: list[Shape]) -> tuple[Array, Array] | None:
    """Lower and upper corner of the body's shapes, None without any."""
    own = [s for s in shapes if not s.joint]
    if not own:
        return None
    lower = np.min([s.points.min(axis=0) - s.radius for s in own], axis=0)
    upper = np.max([s.points.max(axis=0) + s.radius for s in own], axis=0)
    return lower, upper


def _off_segment(points: Array, start: Array, end: Array) -> Array:
    along = end - start
    square = float(along @ along)
    share = np.clip((points - start) @ along / square, 0.0, 1.0) if square > 0 else np.zeros(1)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * along, axis=1))


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
