"""A robot with known legs, prepared for the searches of postures, and its proposal."""

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
from climbplan.robots.self_clearance import (
    compute_body_clearance,
    compute_limb_clearance,
    list_clearance_pairs,
)
from climbplan.robots.urdf.capsule_fit import LIMB_RADIUS
from climbplan.robots.urdf.drives import pad_to_legs
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel, build_urdf_model
from climbplan.robots.urdf.proposal.bracing_grid_search import estimate_full_reach, find_braces
from climbplan.robots.urdf.proposal.draft import Draft
from climbplan.robots.urdf.proposal.leg_naming import LegNaming, find_mirrored_legs
from climbplan.robots.urdf.proposal.motors import GRAVITY, JointMotors, propose_motors
from climbplan.robots.urdf.proposal.postures import (
    LeggedPosture,
    LegModel,
    describe_unmirrored_bounds,
    keep_off_bounds,
)
from climbplan.robots.urdf.proposal.self_collision import (
    SelfCollisionModel,
    build_self_collision_model,
)
from climbplan.robots.urdf.proposal.soles import Soles
from climbplan.robots.urdf.proposal.toes import Toe
from climbplan.robots.urdf.proposal.unused_joints import choose_locked_angles, find_unused_joints
from climbplan.robots.urdf.robot_builder import (
    build_chain_at_zero,
    build_robot_from_urdf,
    read_leg_angles,
)
from climbplan.robots.urdf.shapes import CollisionShape, compute_body_box
from climbplan.schema.robots.urdf.tree import UrdfTree

STRUCTURAL_COMPLIANCE_SHARE = 0.1
FLOOR_FRICTION = 0.8  # rubber on a floor
_MAX_BENDS = 2  # ways to bend legs for which braces are searched
_ANY_STANCE_RADIUS = 0.1  # [m], where a robot is built before its stance is known


@dataclass(frozen=True)
class RobotProposal:
    """A proposed robot configuration with its reasons; N legs in leg order."""

    name: str
    draft: Draft
    tree: UrdfTree
    toes: tuple[Toe, ...]  # (N,)
    naming: LegNaming
    motors: JointMotors
    prepared: PreparedRobot
    standing: dict[str, float]  # posture by joint [deg]
    posture: LeggedPosture  # as it stands on ground, frame of the base
    braces: tuple[LeggedPosture, ...]  # between walls, body frame, best first; may be empty
    brace_failure: str  # why there are none
    robot: Robot  # as it would be planned with
    body_box: tuple[Array, Array] | None  # corners from the base's collision geometry [m]
    half_size: tuple[float, float, float] | None  # of the body without collision geometry [m]
    implausible: tuple[str, ...]  # implausible data of the URDF
    assumptions: tuple[str, ...]  # on what the URDF does not say

    def generate_alternatives(self) -> Iterator[RobotProposal]:
        """Yield the same robot in its other stances, the largest stance radius first."""
        for posture in self.prepared.stances:
            if posture is not self.posture:
                yield self.prepared.build_proposal(posture)


@dataclass(frozen=True)
class PreparedRobot:
    """All that does not depend on how the robot stands, and its candidate stances."""

    draft: Draft
    tree: UrdfTree
    toes: tuple[Toe, ...]  # (N,)
    naming: LegNaming
    shapes: list[CollisionShape]
    geometry_error: str  # why there is no collision geometry; empty if there is
    legs_at_zero: tuple[LegAtZero, ...]  # (N,)
    motors: JointMotors
    legs: LegModel  # frame of the base
    collision_model: SelfCollisionModel | None
    stances: tuple[LeggedPosture, ...]  # best first; empty before they are searched for
    soles: Soles | None = None  # of two legs that stand on flat feet

    @cached_property
    def _model(self) -> UrdfModel:
        return self.draft.build_model()

    def compute_center(self, angles: Array) -> Array:
        """Return the centre of mass (3,) at angles (N, J), frame of the base [m]."""
        return self._model.compute_center(_map_joint_angles(self.legs_at_zero, angles))

    def has_self_collision(self, posture: LeggedPosture) -> bool:
        """Return whether parts of the robot touch; False without collision geometry."""
        angles = _map_joint_angles(self.legs_at_zero, posture.angles)
        model = self.collision_model
        return model is not None and bool(model.find_collisions(angles))

    def build_clearance_function(self, to_body: bool = False) -> Callable[[Array], Array] | None:
        """Return the function from angles (C, N, J) to the distance between limbs (C,) [m].

        Limbs are as thick as in planning. None without collision geometry.

        Args:
            to_body: Whether distances to the body count, too.
        """
        if not self.shapes:
            return None
        robot = self.draft.load_robot(meshes=True)
        # The workspace is not known yet, and does not matter for how thick limbs are
        size = robot.spec.workspace.model_copy(
            update={"reach": 1.0, "stance_radius": _ANY_STANCE_RADIUS}
        )
        spec = robot.spec.model_copy(update={"workspace": size})
        planned = build_robot_from_urdf(replace(robot, spec=spec))

        def compute_clearance(angles: Array) -> Array:
            links = limb_capsules(planned, angles)
            body_pairs, limb_pairs = list_clearance_pairs(planned, links)
            clearance = compute_limb_clearance(links, limb_pairs).min(axis=-1, initial=np.inf)
            if to_body:
                body_parts = planned.body_parts or (planned.body_hull,)
                distance = compute_body_clearance(links, body_pairs, body_parts)
                clearance = np.minimum(clearance, distance.min(axis=-1, initial=np.inf))
            return np.asarray(clearance)

        return compute_clearance

    def build_best_proposal(self) -> RobotProposal:
        """Return the proposal for the first stance of each way to bend legs that has braces.

        Legs are bent as a robot stands when it braces between walls. Where no stance has braces,
        or walls are not asked for, the first stance is the best.
        """
        first = self.build_proposal()
        if first.braces or self.soles is not None:
            return first
        bends = {_describe_bend(first.posture)}
        for posture in self.stances:
            if len(bends) >= _MAX_BENDS or (bend := _describe_bend(posture)) in bends:
                continue
            bends.add(bend)
            proposal = self.build_proposal(posture)
            if proposal.braces:
                return proposal
        return first

    def build_proposal(
        self, posture: LeggedPosture | None = None, walls: bool = True
    ) -> RobotProposal:
        """Return the proposal for one stance.

        Args:
            posture: How the robot stands; None for the best candidate.
            walls: Whether to search for braces between walls.
        """
        posture = self.stances[0] if posture is None else posture
        standing = {
            joint: round(float(np.rad2deg(angle)), 2) + 0.0  # no -0
            for joint, angle in _map_joint_angles(self.legs_at_zero, posture.angles).items()
        }
        legs = {
            name: {**self.draft.legs[name], "posture_deg": {j: standing[j] for j in leg.names}}
            for name, leg in zip(self.naming.names, self.legs_at_zero, strict=True)
        }
        draft = replace(self.draft, legs=legs)
        box, half = compute_body_box(self.shapes), None
        if box is None:
            x, y, z = (round(float(value), 3) for value in np.ptp(self.legs.body_box, axis=0) / 2)
            half = (x, y, z)
        robot = _build_planning_robot(draft, half, self.shapes)

        def is_collision_free(brace: LeggedPosture) -> bool:
            return not self.has_self_collision(brace)

        braces: tuple[LeggedPosture, ...] = ()
        failure = ": flat feet are not put on walls" if self.soles is not None else ""
        if walls and self.soles is None:
            braces, failure = find_braces(robot, self.legs.mirrored_legs, is_collision_free)
        buried = []
        if self.soles is None:
            buried = _describe_buried_toes(self.toes, self.legs_at_zero, self.shapes, draft.foot)
        return RobotProposal(
            name=robot.name,
            draft=draft,
            tree=self.tree,
            toes=self.toes,
            naming=self.naming,
            motors=self.motors,
            prepared=self,
            standing=standing,
            posture=posture,
            braces=braces,
            brace_failure=failure,
            robot=robot,
            body_box=box,
            half_size=half,
            implausible=(
                *self.motors.implausible,
                *_describe_massless_links(self.tree),
                *describe_unmirrored_bounds(self.legs),
                *buried,
            ),
            assumptions=self._list_assumptions(),
        )

    def _list_assumptions(self) -> tuple[str, ...]:
        """Return what is assumed of geometry, names and axes."""
        draft, assumptions = self.draft, []
        if self.geometry_error:
            assumptions.append(f"collision geometry is not read: {self.geometry_error}")
        if missing := draft.missing_meshes:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            assumptions.append(
                f"collision meshes without a file are left out: {missing[0]}{more}, so that sizes "
                "of feet, links and body are guesses: copy the folders of meshes that belong to "
                "the URDF, or name their package's folder in ROS_PACKAGE_PATH, and propose again"
            )
        if not self.naming.is_by_place:
            assumptions.append(
                "legs are no pairs left and right: they have the names of their toes"
            )
        if draft.up != "z":
            assumptions.append(
                f"on hands and feet: the base's {draft.forward} points forward, its {draft.up} up"
            )
        elif draft.forward != "x":
            assumptions.append(
                f"forward is the base's {draft.forward} axis, along which legs are spread"
            )
        return tuple(assumptions)


def _describe_bend(posture: LeggedPosture) -> tuple[float, ...]:
    """Return the directions in which the last joints of legs are bent."""
    return tuple(np.sign(posture.angles[:, -1]).tolist())


def prepare_robot(
    draft: Draft,
    tree: UrdfTree,
    toes: Sequence[Toe],
    naming: LegNaming,
    shapes: list[CollisionShape],
    geometry_error: str,
) -> PreparedRobot:
    """Compute motors, locked joints and the leg model with which postures are searched for.

    Args:
        draft: The robot section so far.
        tree: The URDF.
        toes: Toes of N legs.
        naming: Their names and order.
        shapes: Collision geometry; empty if there is none.
        geometry_error: Why there is none; empty if there is.

    Raises:
        UsageError: The links have no mass.
    """
    model = draft.build_model()
    legs = [model.read_leg(name) for name in naming.names]
    width = max(len(leg.names) for leg in legs)
    mass = model.compute_mass()
    if not mass > 0:
        raise UsageError(f"{tree.path}: the links have no mass, which no proposal can make up")
    lower, upper, posture = read_leg_angles(model.robot, legs, width)
    joints = [tuple(tree.joints[j] for j in leg.names) for leg in legs]
    chain = build_chain_at_zero(legs, width, np.zeros(3), posture)
    reach = estimate_full_reach(chain, lower, upper)
    motors = propose_motors(joints, reach, mass * GRAVITY)
    draft = replace(draft, joints=_build_joint_section(motors))
    bounds = _map_joint_bounds(legs, lower, upper)
    hips = chain.joint_zero[:, 0]
    if shapes:
        unused = find_unused_joints(tree, set(bounds), set(draft.locked))
        meshed = build_urdf_model(draft.load_robot(meshes=True))
        if locked := choose_locked_angles(meshed, unused, bounds, hips):
            draft = replace(draft, locked=draft.locked | locked)
            shapes, _ = draft.read_shapes()
    torque = pad_to_legs(width, [motors.list_torque_limits(leg) for leg in joints], 1.0)
    box = compute_body_box(shapes) or (hips.min(axis=0) - 0.03, hips.max(axis=0) + 0.03)
    mirrored = find_mirrored_legs(hips)
    inner = keep_off_bounds(lower, upper)
    return PreparedRobot(
        draft=draft,
        tree=tree,
        toes=tuple(toes),
        naming=naming,
        shapes=shapes,
        geometry_error=geometry_error,
        legs_at_zero=tuple(legs),
        motors=motors,
        legs=LegModel(chain, *inner, torque, reach, mass * GRAVITY, mirrored, box),
        collision_model=_build_collision_model(draft, bounds) if shapes else None,
        stances=(),
    )


def _build_collision_model(
    draft: Draft, bounds: dict[str, tuple[float, float]]
) -> SelfCollisionModel:
    """Return the self-collision model of the draft; bounds: of joints by name [rad]."""
    return build_self_collision_model(build_urdf_model(draft.load_robot(meshes=True)), bounds)


def _map_joint_bounds(
    legs: Sequence[LegAtZero], lower: Array, upper: Array
) -> dict[str, tuple[float, float]]:
    """Return bounds by joint [rad], from (N, J); one turn where there is more."""
    return {
        joint: (low, high) if high - low <= 2 * np.pi else (-np.pi, np.pi)
        for leg, lows, highs in zip(legs, lower, upper, strict=True)
        for joint, low, high in zip(
            leg.names, lows[-len(leg.names) :], highs[-len(leg.names) :], strict=True
        )
    }


def _map_joint_angles(legs: Sequence[LegAtZero], angles: Array) -> dict[str, float]:
    """Return angles by joint [rad], from (N, J)."""
    return {
        joint: float(angle)
        for leg, row in zip(legs, angles, strict=True)
        for joint, angle in zip(leg.names, row[len(row) - len(leg.names) :], strict=True)
    }


def _build_joint_section(motors: JointMotors) -> dict[str, dict[str, float]]:
    """Return the section's limits where the URDF's are implausible, and unusual stiffness."""
    section = {}
    for name, motor in motors.joints.items():
        limits = {"max_torque": motor.max_torque, "max_speed": motor.max_speed}
        values = {key: value for key, value in limits.items() if value is not None}
        if motor.stiffness != motors.stiffness:
            values["stiffness"] = motor.stiffness
        if values:
            section[name] = values
    return section


def _build_planning_robot(
    draft: Draft,
    half: tuple[float, ...] | None,
    shapes: list[CollisionShape],
) -> Robot:
    """Return the robot as planning has it; half: extents of the body without geometry [m]."""
    robot = draft.load_robot(meshes=bool(shapes))
    update: dict[str, Any] = {"body_half_size": half}
    if not shapes:
        update["limb_radius"] = LIMB_RADIUS
    return build_robot_from_urdf(replace(robot, spec=robot.spec.model_copy(update=update)))


def _describe_massless_links(tree: UrdfTree) -> list[str]:
    """Return a note on links that joints move and that weigh nothing with all fixed to them."""
    mass = tree.moving_mass
    massless = [name for name, value in mass.items() if value == 0]
    if not massless:
        return []
    listed = ", ".join(massless[:4]) + (
        f" and {len(massless) - 4} more" if len(massless) > 4 else ""
    )
    return [f"{len(massless)} of {len(mass)} moving links have no mass: {listed}"]


def _describe_buried_toes(
    toes: Sequence[Toe], legs: Sequence[LegAtZero], shapes: list[CollisionShape], foot: float
) -> list[str]:
    """Return a note on toes beyond which the collision geometry of their links reaches.

    foot: radius of spherical feet [m], which reach so far.
    """
    depth: dict[str, float] = {}
    for toe, leg in zip(toes, legs, strict=True):
        deepest = foot
        direction = leg.toe - leg.joints[-1]
        length = float(np.linalg.norm(direction))
        for shape in shapes:
            if shape.joint == leg.names[-1] and length > 0:
                beyond = (shape.points - leg.toe) @ (direction / length) + shape.radius
                deepest = max(deepest, float(beyond.max()))
        if deepest > foot + 1e-3:
            depth[toe.link] = 1e3 * deepest
    if not depth:
        return []
    low, high = f"{min(depth.values()):.0f}", f"{max(depth.values()):.0f}"
    span = high if low == high else f"{low} to {high}"
    where = f"beyond toes {', '.join(depth)} their limbs go on for {span} mm along their direction"
    return [f"{where}, and touch that much earlier; `toe_offset` moves them"]
