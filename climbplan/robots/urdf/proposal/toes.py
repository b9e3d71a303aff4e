"""Choice of the toe of a limb: a point of its last body."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.robots.urdf.shapes import CollisionShape
from climbplan.robots.urdf.toe_surface import compute_offset_in_link

_FOOT_NAME = re.compile(r"foot|feet|toe|sole|tip|contact", re.IGNORECASE)
_MIN_JOINT_DISTANCE = 0.01  # [m] of a toe's frame from the last joint
_MIN_REACH_RATIO = 0.6  # distance of a toe's frame over that of the farthest geometry
_MAX_CENTER_OFFSET = 1.05  # radii of a sphere, within which a toe belongs to it
_TOLERANCE = 1e-4  # [m]
NEGLIGIBLE_RANGE = np.deg2rad(2.0)  # [rad] of a joint that counts as fixed
_NEGLIGIBLE_SLIDE = 0.03  # range of a slide that counts as fixed, over the size of the robot
_END_FRACTION = 0.03  # of the distance, within which points of a shape are its end


@dataclass(frozen=True)
class Toe:
    """The toe of a limb, and the reason for it."""

    link: str
    offset: tuple[float, float, float]  # in the link's frame [m]
    reason: str
    is_truncated: bool = False  # whether the limb ends there, before weak motors


def find_toe(urdf_model: UrdfModel, joint: str, end: str, shapes: list[CollisionShape]) -> Toe:
    """Find the toe of a limb.

    A link fixed to the last body whose name is that of a foot (foot, toe, sole, tip, contact) is
    the toe. Otherwise it is the end of the collision geometry, if that reaches well beyond all
    fixed links, or else the fixed link farthest from the joint.

    Args:
        urdf_model: The robot.
        joint: The last joint of the limb.
        end: The link that it moves.
        shapes: All collision geometry; empty if there is none.
    """
    pin, model = urdf_model.library, urdf_model.model
    data = model.createData()
    pin.forwardKinematics(model, data, urdf_model.build_configuration({}))
    pin.updateFramePlacements(model, data)
    index = model.getJointId(joint)
    origin = data.oMi[index].translation
    bodies = {index} | _find_bodies_fixed_to(urdf_model, index, data)
    places = {
        frame.name: data.oMf[i].translation
        for i, frame in enumerate(model.frames)
        if frame.parentJoint in bodies and frame.type == pin.FrameType.BODY
    }
    fixed = {
        frame.name
        for frame in model.frames
        if frame.parentJoint == index and frame.type == pin.FrameType.BODY
    }
    reaches = {name: float(np.linalg.norm(place - origin)) for name, place in places.items()}
    named_feet = [
        name
        for name, distance in reaches.items()
        if distance > _MIN_JOINT_DISTANCE and _FOOT_NAME.search(name)
    ]
    if named_feet:
        link = max(named_feet, key=lambda name: reaches[name])
        if link in fixed:
            return Toe(link, (0.0, 0.0, 0.0), "by its name")
        point = urdf_model.to_base_axes(places[link])
        return build_toe(urdf_model, end, point, f"where {link} is, by its name")
    distances = {
        name: distance
        for name, distance in reaches.items()
        if name in fixed and distance > _MIN_JOINT_DISTANCE
    }
    far_end, reach = _find_far_end(urdf_model, origin, joint, shapes)
    farthest = max(distances, key=lambda name: distances[name], default=None)
    if farthest is not None and distances[farthest] >= _MIN_REACH_RATIO * reach:
        return Toe(farthest, (0.0, 0.0, 0.0), "the farthest frame of its last body")
    if far_end is None:
        return Toe(end, (0.0, 0.0, 0.0), "ASSUMED: nothing says how long the last link is")
    return build_toe(urdf_model, end, far_end, "the end of its last body's collision geometry")


def _find_bodies_fixed_to(urdf_model: UrdfModel, index: int, data: Any) -> set[int]:
    """Return the Pinocchio joints beyond a joint that hardly move against it.

    Args:
        urdf_model: The robot.
        index: Of the joint.
        data: Pinocchio's, with the places of frames at zero angles.
    """
    model, joints = urdf_model.model, urdf_model.robot.tree.joints
    points = np.array([frame.translation for frame in data.oMf])
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    bodies: set[int] = set()
    for body in range(index + 1, int(model.njoints)):
        joint = joints.get(str(model.names[body]))
        if joint is None or int(model.parents[body]) not in bodies | {index}:
            continue
        limit = NEGLIGIBLE_RANGE if joint.turns else _NEGLIGIBLE_SLIDE * size
        if joint.upper - joint.lower < limit:
            bodies.add(body)
    return bodies


def build_toe(urdf_model: UrdfModel, link: str, point: Array, reason: str) -> Toe:
    """Return a toe at a point of a link.

    Args:
        urdf_model: The robot.
        link: The link that the toe is on.
        point: (3,) at zero angles, base frame turned to x right, y forward, z up [m].
        reason: Why the toe is there.
    """
    return Toe(link, compute_offset_in_link(urdf_model, link, point), reason)


def center_on_spherical_feet(
    urdf_model: UrdfModel, names: Sequence[str], toes: list[Toe], shapes: list[CollisionShape]
) -> tuple[list[Toe], float]:
    """Move toes to the centres of spherical feet.

    A foot is a sphere of the last body's collision geometry around the toe, or that touches it,
    with nothing of that body beyond.

    Args:
        urdf_model: The robot.
        names: Its legs, N of them.
        toes: (N,) toes.
        shapes: All collision geometry.

    Returns:
        The toes and the radius of the feet [m]. Unchanged toes and 0 unless all legs have spherical
        feet of the same size.
    """
    centred, radii = [], []
    for name, toe in zip(names, toes, strict=True):
        leg = urdf_model.read_leg(name)
        leg_shapes = [shape for shape in shapes if shape.joint == leg.names[-1]]
        spheres = [
            sphere
            for sphere in leg_shapes
            if len(sphere.points) == 1
            and np.linalg.norm(sphere.points[0] - leg.toe) <= _MAX_CENTER_OFFSET * sphere.radius
        ]
        if not spheres:
            return toes, 0.0
        foot = max(spheres, key=lambda shape: shape.radius)
        direction = foot.points[0] - leg.joints[-1]
        length = float(np.linalg.norm(direction))
        if not foot.radius < length:
            return toes, 0.0
        extents = [
            float((sphere.points @ direction).max()) / length + sphere.radius
            for sphere in leg_shapes
        ]
        if max(extents) > float(foot.points[0] @ direction) / length + foot.radius + _TOLERANCE:
            return toes, 0.0
        if np.linalg.norm(foot.points[0] - leg.toe) > _TOLERANCE:
            toe = build_toe(
                urdf_model, toe.link, foot.points[0], f"{toe.reason}; the centre of its sphere"
            )
        centred.append(toe)
        radii.append(foot.radius)
    if max(radii) - min(radii) > _TOLERANCE:
        return toes, 0.0
    return centred, round(float(np.mean(radii)), 4)


def _find_far_end(
    urdf_model: UrdfModel, origin: Array, joint: str, shapes: list[CollisionShape]
) -> tuple[Array | None, float]:
    """Return the middle of the farthest points of a joint's shapes and their distance [m].

    None and 0 without shapes.
    """
    joint_position = urdf_model.to_base_axes(origin)
    joint_shapes = [shape for shape in shapes if shape.joint == joint]
    if not joint_shapes:
        return None, 0.0
    points = np.concatenate([shape.points for shape in joint_shapes])
    distances = np.linalg.norm(points - joint_position, axis=1)
    reach = float(distances.max())
    return points[distances >= (1 - _END_FRACTION) * reach].mean(axis=0), reach
