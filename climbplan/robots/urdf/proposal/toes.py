"""Which point of a limb's last body is its toe."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.robots.urdf.shapes import Shape
from climbplan.robots.urdf.toe_surface import offset_in_link

_FEET = re.compile(r"foot|feet|toe|sole|tip|contact", re.IGNORECASE)
_OFF_JOINT = 0.01  # [m] a frame this close to the joint is no toe
_FAR = 0.6  # of the farthest collision geometry, that a frame has to be away to be a toe
_ROUND_TOE = 1.05  # radii of a sphere within which a toe belongs to it
_SAME = 1e-4  # [m]
_ENDS = 0.03  # of the distance, within which points of a shape count as its end


@dataclass(frozen=True)
class Toe:
    """A toe, and why it is one."""

    link: str
    offset: tuple[float, float, float]  # in the link's frame [m]
    why: str
    is_cut: bool = False  # whether the limb ends there before motors too weak for it


def toe_of(found: UrdfModel, joint: str, end: str, shapes: list[Shape]) -> Toe:
    """The toe of the limb whose last joint is `joint`, which moves the link `end`.

    Links fixed to that body count by their names (foot, toe, sole, tip, contact), then by how far
    they are from the joint; where collision geometry goes well beyond all of them, its end does.
    """
    pin, model = found.library, found.model
    data = model.createData()
    pin.forwardKinematics(model, data, found.angles({}))
    pin.updateFramePlacements(model, data)
    index = model.getJointId(joint)
    origin = data.oMi[index].translation
    links = [
        (frame.name, float(np.linalg.norm(data.oMf[i].translation - origin)))
        for i, frame in enumerate(model.frames)
        if frame.parentJoint == index and frame.type == pin.FrameType.BODY
    ]
    away = {name: distance for name, distance in links if distance > _OFF_JOINT}
    feet = [name for name in away if _FEET.search(name)]
    if feet:
        link = max(feet, key=lambda name: away[name])
        return Toe(link, (0.0, 0.0, 0.0), "by its name")
    points, reach = _end_of_shapes(found, origin, joint, shapes)
    farthest = max(away, key=lambda name: away[name], default=None)
    if farthest is not None and away[farthest] >= _FAR * reach:
        return Toe(farthest, (0.0, 0.0, 0.0), "the farthest frame of its last body")
    if points is None:
        return Toe(end, (0.0, 0.0, 0.0), "ASSUMED: nothing says how long the last link is")
    return toe_at(found, end, points, "the end of its last body's collision geometry")


def toe_at(found: UrdfModel, link: str, point: Array, why: str) -> Toe:
    """A toe at a point (3,) of a link, at zero angles, base frame turned to x right, y forward."""
    return Toe(link, offset_in_link(found, link, point), why)


def spherical(
    found: UrdfModel, names: Sequence[str], toes: list[Toe], shapes: list[Shape]
) -> tuple[list[Toe], float]:
    """Toes in the centres of spherical feet, and the radius of these [m]; as they are, 0 for none.

    A foot is a sphere of the last body's collision geometry round the toe, or that touches it, with
    nothing of that body beyond. All legs (names) have to have one, of the same size.
    """
    centred, radii = [], []
    for name, toe in zip(names, toes, strict=True):
        leg = found.leg(name)
        own = [shape for shape in shapes if shape.joint == leg.names[-1]]
        balls = [
            s
            for s in own
            if len(s.points) == 1 and np.linalg.norm(s.points[0] - leg.toe) <= _ROUND_TOE * s.radius
        ]
        if not balls:
            return toes, 0.0
        foot = max(balls, key=lambda shape: shape.radius)
        along = foot.points[0] - leg.joints[-1]
        length = float(np.linalg.norm(along))
        if not foot.radius < length:
            return toes, 0.0
        ahead = [float((s.points @ along).max()) / length + s.radius for s in own]
        if max(ahead) > float(foot.points[0] @ along) / length + foot.radius + _SAME:
            return toes, 0.0
        if np.linalg.norm(foot.points[0] - leg.toe) > _SAME:
            toe = toe_at(found, toe.link, foot.points[0], f"{toe.why}; the centre of its sphere")
        centred.append(toe)
        radii.append(foot.radius)
    if max(radii) - min(radii) > _SAME:
        return toes, 0.0
    return centred, round(float(np.mean(radii)), 4)


def _end_of_shapes(
    found: UrdfModel, origin: Array, joint: str, shapes: list[Shape]
) -> tuple[Array | None, float]:
    """The middle of the farthest part of a joint's shapes and its distance; None without any."""
    here = found.placed(origin)
    own = [shape for shape in shapes if shape.joint == joint]
    if not own:
        return None, 0.0
    points = np.concatenate([shape.points for shape in own])
    far = np.linalg.norm(points - here, axis=1)
    reach = float(far.max())
    return points[far >= (1 - _ENDS) * reach].mean(axis=0), reach
