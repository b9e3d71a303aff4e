"""A robot whose legs are settled: how it stands, how it braces, and what is proposed of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.touching_parts import limbs_room, parts_beside
from climbplan.robots.urdf.building import chain_at_zero, joint_angles_of, robot_of_urdf
from climbplan.robots.urdf.capsule_fit import LIMB_RADIUS
from climbplan.robots.urdf.drives import by_leg
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel, urdf_model
from climbplan.robots.urdf.proposal.braces import (
    braces_of,
    farthest,
)
from climbplan.robots.urdf.proposal.draft import Draft
from climbplan.robots.urdf.proposal.idle import idle_joints, rest_of
from climbplan.robots.urdf.proposal.motors import GRAVITY, Motors, motors_of
from climbplan.robots.urdf.proposal.naming import Named, mirrored
from climbplan.robots.urdf.proposal.postures import (
    Legs,
    Posture,
)
from climbplan.robots.urdf.proposal.soles import Soles
from climbplan.robots.urdf.proposal.toes import Toe
from climbplan.robots.urdf.proposal.touching import Parts, parts_of
from climbplan.robots.urdf.shapes import Shape, body_box
from climbplan.schema.robots.urdf.tree import UrdfTree

SHARE = 0.1  # of compliance in the structure
FLOOR = 0.8  # friction: rubber on a floor


@dataclass(frozen=True)
class Proposal:
    """What is proposed of a robot, and why. N legs in their order."""

    name: str
    draft: Draft
    tree: UrdfTree
    toes: tuple[Toe, ...]  # (N,)
    named: Named
    motors: Motors
    settled: Settled
    standing: dict[str, float]  # posture by joint [deg]
    posture: Posture  # as it stands on ground, frame of the base
    braces: tuple[Posture, ...]  # between walls, body frame, best first; may be none
    lacks: str  # why there are none
    robot: Robot  # as it would be planned with
    body_box: tuple[Array, Array] | None  # corners from the base's collision geometry [m]
    half_size: tuple[float, float, float] | None  # of the body, where there is none of it [m]
    odd: tuple[str, ...]  # implausible data of the URDF
    assumed: tuple[str, ...]  # what else is not in it

    def otherwise(self) -> Iterator[Proposal]:
        """The same robot in its other standing postures, roomiest first."""
        for posture in self.settled.standings:
            if posture is not self.posture:
                yield self.settled.proposal(posture)


@dataclass(frozen=True)
class Settled:
    """Everything that does not depend on how the robot stands, and the ways in which it may."""

    draft: Draft
    tree: UrdfTree
    toes: tuple[Toe, ...]  # (N,)
    named: Named
    shapes: list[Shape]
    unread: str  # why there is no collision geometry
    at_zero: tuple[LegAtZero, ...]  # (N,)
    motors: Motors
    legs: Legs  # frame of the base
    parts: Parts | None
    standings: tuple[Posture, ...]  # roomiest first; none before they are looked for
    soles: Soles | None = None  # of two legs that stand on flat feet

    @cached_property
    def _model(self) -> UrdfModel:
        return self.draft.model()

    def center(self, angles: Array) -> Array:
        """(3,) centre of mass at angles (N, J), frame of the base [m]."""
        return self._model.center(_by_joint(self.at_zero, angles))

    def touching(self, posture: Posture) -> bool:
        """Whether parts of the robot touch in a posture; not, without collision geometry."""
        angles = _by_joint(self.at_zero, posture.angles)
        return self.parts is not None and bool(self.parts.touching(angles))

    def beside(self) -> Callable[[Array], Array] | None:
        """Room (C,) [m] between limbs at angles (C, N, J), as thick as planning takes them."""
        if not self.shapes:
            return None
        robot = self.draft.robot(meshes=True)
        # No stance is settled yet, and none is needed for how thick limbs are
        size = robot.spec.workspace.model_copy(update={"reach": 1.0, "stance_radius": SHARE})
        spec = robot.spec.model_copy(update={"workspace": size})
        planned = robot_of_urdf(replace(robot, spec=spec))

        def room(angles: Array) -> Array:
            links = limb_capsules(planned, angles)
            _, pairs = parts_beside(planned, links)
            return np.asarray(limbs_room(links, pairs).min(axis=-1, initial=np.inf))

        return room

    def proposal(self, posture: Posture | None = None, walls: bool = True) -> Proposal:
        """What is proposed of the robot in one of its standing postures, else in the roomiest.

        walls: whether to look for how it braces between walls.
        """
        posture = self.standings[0] if posture is None else posture
        standing = {
            joint: round(float(np.rad2deg(angle)), 2) + 0.0  # no -0
            for leg, row in zip(self.at_zero, posture.angles, strict=True)
            for joint, angle in zip(leg.names, row[len(row) - len(leg.names) :], strict=True)
        }
        legs = {
            name: {**self.draft.legs[name], "posture_deg": {j: standing[j] for j in leg.names}}
            for name, leg in zip(self.named.names, self.at_zero, strict=True)
        }
        draft = replace(self.draft, legs=legs)
        box, half = body_box(self.shapes), None
        if box is None:
            x, y, z = (round(float(value), 3) for value in np.ptp(self.legs.box, axis=0) / 2)
            half = (x, y, z)
        robot = _planned_with(draft, half, self.shapes)

        def apart(brace: Posture) -> bool:
            return not self.touching(brace)

        braces: tuple[Posture, ...] = ()
        lacks = ": flat feet are not put on walls" if self.soles is not None else ""
        if walls and self.soles is None:
            braces, lacks = braces_of(robot, self.legs.mirror, apart)
        assumed = []
        if self.unread:
            assumed.append(f"collision geometry is not read: {self.unread}")
        if not self.named.by_place:
            assumed.append("legs are no pairs left and right: they have the names of their toes")
        if draft.up != "z":
            assumed.append(
                f"on hands and feet: the base's {draft.forward} points forward, its {draft.up} up"
            )
        elif draft.forward != "x":
            assumed.append(
                f"forward is the base's {draft.forward} axis, along which legs are spread"
            )
        buried = []
        if self.soles is None:
            buried = _buried(self.toes, self.at_zero, self.shapes, draft.foot)
        odd = (*self.motors.odd, *_masses(self.tree), *buried)
        return Proposal(
            robot.name, draft, self.tree, self.toes, self.named, self.motors, self, standing,
            posture, braces, lacks, robot, box, half, odd, tuple(assumed),
        )  # fmt: skip


def measured(
    draft: Draft,
    tree: UrdfTree,
    toes: Sequence[Toe],
    names: Named,
    shapes: list[Shape],
    unread: str,
) -> Settled:
    """Motors and idle joints of legs that are settled, and what postures are searched for with.

    Raises UsageError for links without mass.
    """
    model = draft.model()
    at_zero = [model.leg(name) for name in names.names]
    width = max(len(leg.names) for leg in at_zero)
    mass = model.mass()
    if not mass > 0:
        raise UsageError(f"{tree.path}: the links have no mass, which no proposal can make up")
    lower, upper, rest = (
        by_leg(width, [[values[j] for j in leg.names] for leg in at_zero], empty)
        for values, empty in zip(joint_angles_of(model.robot), (-1.0, 1.0, 0.0), strict=True)
    )
    joints = [tuple(tree.joints[j] for j in leg.names) for leg in at_zero]
    chain = chain_at_zero(at_zero, width, np.zeros(3), rest)
    reach = farthest(chain, lower, upper)
    motors = motors_of(joints, reach, mass * GRAVITY)
    draft = replace(draft, joints=_stated(motors))
    bounds = {
        joint: (low, high) if high - low <= 2 * np.pi else (-np.pi, np.pi)
        for leg, lows, highs in zip(at_zero, lower, upper, strict=True)
        for joint, low, high in zip(
            leg.names, lows[-len(leg.names) :], highs[-len(leg.names) :], strict=True
        )
    }
    hips = chain.joint_zero[:, 0]
    if shapes:
        idle = idle_joints(tree, set(bounds), set(draft.locked))
        if held := rest_of(urdf_model(draft.robot(meshes=True)), idle, bounds, hips):
            draft = replace(draft, locked=draft.locked | held)
            shapes, _ = draft.shapes()
    torque = by_leg(
        width,
        [
            [motors.joints[j.name].max_torque or float(j.effort or 0.0) for j in own]
            for own in joints
        ],
        1.0,
    )
    inner = body_box(shapes) or (hips.min(axis=0) - 0.03, hips.max(axis=0) + 0.03)
    legs = Legs(chain, lower, upper, torque, reach, mass * GRAVITY, mirrored(hips), inner)
    parts = parts_of(urdf_model(draft.robot(meshes=True)), bounds) if shapes else None
    return Settled(
        draft, tree, tuple(toes), names, shapes, unread, tuple(at_zero), motors, legs, parts, (),
    )  # fmt: skip


def _by_joint(legs: Sequence[LegAtZero], angles: Array) -> dict[str, float]:
    """Angles (N, J) by joint."""
    return {
        joint: float(angle)
        for leg, row in zip(legs, angles, strict=True)
        for joint, angle in zip(leg.names, row[len(row) - len(leg.names) :], strict=True)
    }


def _stated(motors: Motors) -> dict[str, dict[str, float]]:
    """What the section says of joints: where the URDF says nonsense, and other stiffness."""
    out = {}
    for name, motor in motors.joints.items():
        own = {"max_torque": motor.max_torque, "max_speed": motor.max_speed}
        given = {key: value for key, value in own.items() if value is not None}
        if motor.stiffness != motors.stiffness:
            given["stiffness"] = motor.stiffness
        if given:
            out[name] = given
    return out


def _planned_with(
    draft: Draft,
    half: tuple[float, ...] | None,
    shapes: list[Shape],
) -> Robot:
    """The robot as planning has it."""
    robot = draft.robot(meshes=bool(shapes))
    update: dict[str, Any] = {"body_half_size": half}
    if not shapes:
        update["limb_radius"] = LIMB_RADIUS
    return robot_of_urdf(replace(robot, spec=robot.spec.model_copy(update=update)))


def _masses(tree: UrdfTree) -> list[str]:
    """Links that joints move and that weigh nothing, with all that is fixed to them."""
    mass = tree.moving_mass
    empty = [name for name, own in mass.items() if own == 0]
    if not empty:
        return []
    shown = ", ".join(empty[:4]) + (f" and {len(empty) - 4} more" if len(empty) > 4 else "")
    return [f"{len(empty)} of {len(mass)} moving links have no mass: {shown}"]


def _buried(
    toes: Sequence[Toe], legs: Sequence[LegAtZero], shapes: list[Shape], foot: float
) -> list[str]:
    """Toes beyond which the collision geometry of all that they move with reaches.

    foot: [m] radius of spherical feet, which reach so far.
    """
    depth: dict[str, float] = {}
    for toe, leg in zip(toes, legs, strict=True):
        own = [shape for shape in shapes if shape.joint == leg.names[-1]]
        deepest = foot
        for shape in own:
            along = leg.toe - leg.joints[-1]
            length = float(np.linalg.norm(along))
            if length > 0:
                beyond = (shape.points - leg.toe) @ (along / length) + shape.radius
                deepest = max(deepest, float(beyond.max()))
        if deepest > foot + 1e-3:
            depth[toe.link] = 1e3 * deepest
    if not depth:
        return []
    least, most = f"{min(depth.values()):.0f}", f"{max(depth.values()):.0f}"
    span = most if least == most else f"{least} to {most}"
    where = f"beyond toes {', '.join(depth)} their limbs go on for {span} mm along their direction"
    return [f"{where}, and touch that much earlier; `toe_offset` moves them"]
