"""From a URDF alone to a robot that can be planned with, and how it may stand and brace."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.errors import SpecError, UsageError
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.building import by_leg, chain_at_zero, joint_angles_of, robot_of_urdf
from climbplan.robots.urdf.capsule_fit import LIMB_RADIUS
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel, urdf_model
from climbplan.robots.urdf.proposal.draft import Draft
from climbplan.robots.urdf.proposal.limbs import FoundLimb, alike, body_link, legs_among, limbs_of
from climbplan.robots.urdf.proposal.motors import Motors, motors_of
from climbplan.robots.urdf.proposal.naming import Named, mirrored, named
from climbplan.robots.urdf.proposal.postures import (
    Legs,
    Posture,
    bracing_postures,
    standing_postures,
)
from climbplan.robots.urdf.proposal.toes import Toe, toe_of
from climbplan.robots.urdf.proposal.touching import Parts, parts_of
from climbplan.robots.urdf.shapes import Shape, body_box
from climbplan.robots.urdf.workspace import farthest_toes, stance_balls
from climbplan.spec.robots.urdf.tree import UrdfTree, read_urdf
from climbplan.spec.robots.urdf.xml import UrdfFault, UrdfFaults

GRAVITY = 9.81  # [m/s^2]
CLEARANCE = 0.02  # [m] of body and knees from walls
SAFETY = 1.2  # S_mu
WALLS = {1.0: "rubber on anti-slip tape", 1.5: "climbing rubber on grit; it may not brace on less"}
_IN_HAND = 0.95  # of the friction that may be used
SHARE = 0.1  # of compliance in the structure
_TRIED = 24  # postures whose room is measured with exact kinematics
_BRACES = 16  # postures between walls that are kept, for the planner to choose from
_AHEAD = 1.3  # times as far apart front to rear as side to side: how legs tell forward from aside
_LONGEST = 0.97  # share of reach that `farthest_toes` gives
_LEG_NAMES = "limb {}"


@dataclass(frozen=True)
class Proposal:
    """What is proposed of a robot, and why. N legs in their order."""

    name: str
    draft: Draft
    tree: UrdfTree
    toes: tuple[Toe, ...]  # (N,)
    named: Named
    motors: Motors
    standing: dict[str, float]  # posture by joint [deg]
    posture: Posture  # as it stands on ground, frame of the base
    braces: tuple[Posture, ...]  # between walls, body frame, best first; may be none
    robot: Robot  # as it would be planned with
    body_box: tuple[Array, Array] | None  # corners from the base's collision geometry [m]
    half_size: tuple[float, float, float] | None  # of the body, where there is none of it [m]
    odd: tuple[str, ...]  # implausible data of the URDF
    assumed: tuple[str, ...]  # what else is not in it


def propose(urdf: Path, packages: dict[str, str] | None = None) -> Proposal:
    """Look at a URDF.

    Raises SpecError for what is wrong in it and UsageError where nothing can be proposed: too few
    limbs, or no posture in which it stands.
    """
    tree = _tree(urdf)
    base = body_link(tree)
    found = limbs_of(tree, base)
    limbs = found.limbs
    if len(limbs) < 3:
        have = ", ".join(limb.end for limb in limbs) or "none"
        raise UsageError(
            f"{urdf}: expected three limbs or more of at least 3 joints that turn, carried by the "
            f"body {base!r}, found {len(limbs)} (ending at: {have})"
        )
    locked = [*found.shared, *(joint for limb in limbs for joint in limb.locked)]
    draft = Draft(
        urdf=urdf.resolve(),
        base=base,
        legs={_LEG_NAMES.format(i): {"toe": limb.end} for i, limb in enumerate(limbs)},
        joints={
            j.name: {"max_torque": 1.0, "max_speed": 1.0} for limb in limbs for j in limb.joints
        },
        locked={joint.name: _rest(joint.lower, joint.upper) for joint in locked},
        packages=dict(packages or {}),
    )
    shapes, unread = draft.shapes()
    model = draft.model()
    toes = [toe_of(model, limb.joints[-1].name, limb.end, shapes) for limb in limbs]
    draft.legs = {
        _LEG_NAMES.format(i): {"toe": toe.link, "toe_offset": list(toe.offset)}
        for i, toe in enumerate(toes)
    }
    legs, groups = _chosen(draft, limbs, urdf)
    draft, model, hips = _facing(draft, limbs, legs, groups)
    links = [toes[i].link for i in legs]
    names = named(hips, links, [groups[i] for i in legs])
    legs = [legs[i] for i in names.order]
    draft.legs = {
        name: {"toe": toes[i].link, "toe_offset": list(toes[i].offset)}
        for name, i in zip(names.names, legs, strict=True)
    }
    ways = {joint.name for i in legs for joint in tree.way_to(limbs[i].end, base) or []}
    out = {joint.name for i in legs for joint in limbs[i].locked}
    draft.locked = {n: angle for n, angle in draft.locked.items() if n in ways or n in out}
    shapes, unread = draft.shapes()
    return _with_postures(draft, tree, [toes[i] for i in legs], names, shapes, unread)


def _tree(urdf: Path) -> UrdfTree:
    try:
        tree = read_urdf(urdf)
    except (UrdfFault, UrdfFaults) as error:
        faults = error.faults if isinstance(error, UrdfFaults) else [error]
        from climbplan.errors import SpecMistake

        told = [SpecMistake("", fault.message, fault.line) for fault in faults]
        raise SpecError(str(urdf), told) from error
    return tree


def _rest(lower: float, upper: float) -> float:
    """Zero, or the middle of bounds that leave it out [deg]."""
    return 0.0 if lower <= 0 <= upper else round(float(np.rad2deg((lower + upper) / 2)), 2)


def _chosen(
    draft: Draft, limbs: tuple[FoundLimb, ...], urdf: Path
) -> tuple[list[int], dict[int, int]]:
    """Limbs that are to be legs, and the group of alike limbs that each is of."""
    model = draft.model()
    lengths = {i: _length(model.leg(_LEG_NAMES.format(i))) for i in range(len(limbs))}
    grouped = alike(lengths, {i: len(limb.joints) for i, limb in enumerate(limbs)})
    chosen = legs_among(grouped)
    if not chosen:
        raise UsageError(f"{urdf}: no three limbs that could be legs")
    return chosen, {i: number for number, group in enumerate(grouped) for i in group}


def _length(leg: LegAtZero) -> float:
    ends = np.concatenate([leg.joints, leg.toe[None]])
    return float(np.linalg.norm(np.diff(ends, axis=0), axis=1).sum())


def _facing(
    draft: Draft, limbs: tuple[FoundLimb, ...], legs: list[int], groups: dict[int, int]
) -> tuple[Draft, UrdfModel, Array]:
    """The draft with the axis that points forward, its model and first joints of legs (N, 3)."""
    for forward in ("x", "y"):
        turned = replace(draft, forward=forward)
        model = turned.model()
        hips = np.array([model.leg(_LEG_NAMES.format(i)).joints[0] for i in legs])
        wide, long, _ = np.ptp(hips, axis=0)
        one_kind = len({groups[i] for i in legs}) == 1 and len(legs) > 3
        if not (one_kind and wide > _AHEAD * long):
            break
    return turned, model, hips


def _with_postures(
    draft: Draft,
    tree: UrdfTree,
    toes: list[Toe],
    names: Named,
    shapes: list[Shape],
    unread: str,
) -> Proposal:
    """The rest of a proposal, for legs that are settled."""
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
    chain = chain_at_zero(at_zero, width, np.zeros(3), rest)
    reach = _farthest(chain, lower, upper)
    joints = [tuple(tree.joints[j] for j in leg.names) for leg in at_zero]
    motors = motors_of(joints, reach, mass * GRAVITY)
    draft = replace(draft, joints=_stated(motors))
    torque = by_leg(
        width,
        [
            [motors.joints[j.name].max_torque or float(j.effort or 0.0) for j in own]
            for own in joints
        ],
        1.0,
    )
    box = body_box(shapes)
    hips = chain.joint_zero[:, 0]
    inner = box or (hips.min(axis=0) - 0.03, hips.max(axis=0) + 0.03)
    weight = mass * GRAVITY
    legs = Legs(chain, lower, upper, torque, reach, weight, mirrored(hips), inner)
    parts = None
    if shapes:
        span = 2 * np.pi
        bounds = {
            joint: (low, high) if high - low <= span else (-np.pi, np.pi)
            for leg, lows, highs in zip(at_zero, lower, upper, strict=True)
            for joint, low, high in zip(
                leg.names, lows[-len(leg.names) :], highs[-len(leg.names) :], strict=True
            )
        }
        parts = parts_of(urdf_model(draft.robot(meshes=True)), bounds)
    standing_fine = [
        one for one in standing_postures(legs, _TRIED) if not _touching(parts, at_zero, one)
    ]
    posture = _roomiest(legs, standing_fine)
    if posture is None:
        raise UsageError(
            f"{tree.path}: found no posture in which it stands with {', '.join(names.names)} "
            f"(toes {', '.join(toe.link for toe in toes)}): `climbplan new robot --example "
            "robot_walker` shows what to write by hand"
        )
    standing = {
        joint: round(float(np.rad2deg(angle)), 2)
        for leg, row in zip(at_zero, posture.angles, strict=True)
        for joint, angle in zip(leg.names, row[width - len(leg.names) :], strict=True)
    }
    for leg in at_zero:
        own = {joint: standing[joint] for joint in leg.names}
        draft.legs[names.names[at_zero.index(leg)]]["posture_deg"] = own
    half = None
    if box is None:
        x, y, z = (round(float(value), 3) for value in np.ptp(inner, axis=0) / 2)
        half = (x, y, z)
    robot = _planned_with(draft, half, shapes)
    braces = tuple(
        brace for brace in _braces(robot, legs.mirror) if not _touching(parts, at_zero, brace)
    )
    assumed = []
    if unread:
        assumed.append(f"collision geometry is not read: {unread}")
    if not names.by_place:
        assumed.append("legs are no pairs left and right: they have the names of their toes")
    if draft.forward != "x":
        assumed.append(f"forward is the base's {draft.forward} axis, along which legs are spread")
    odd = (*motors.odd, *_masses(tree), *_buried(toes, at_zero, shapes))
    return Proposal(
        robot.name, draft, tree, tuple(toes), names, motors, standing, posture, braces, robot,
        box, half, odd, tuple(assumed),
    )  # fmt: skip


def _touching(parts: Parts | None, legs: list[LegAtZero], posture: Posture) -> bool:
    """Whether parts of the robot touch in a posture; not, where there is no collision geometry."""
    if parts is None:
        return False
    angles = {
        joint: float(angle)
        for leg, row in zip(legs, posture.angles, strict=True)
        for joint, angle in zip(leg.names, row[len(row) - len(leg.names) :], strict=True)
    }
    return bool(parts.touching(angles))


def _farthest(chain: SerialChain, lower: Array, upper: Array) -> Array:
    """(N,) farthest toe of sampled postures from the first joint [m]."""
    low, high = np.clip(lower, -np.pi, np.pi), np.clip(upper, -np.pi, np.pi)
    return farthest_toes(chain, low, high) / _LONGEST


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


def _roomiest(legs: Legs, found: list[Posture]) -> Posture | None:
    """The posture with most room by exact kinematics, less what motors have not left."""
    best, most = None, 0.0
    for posture in found:
        chain = replace(legs.chain, posture=posture.angles)
        ball = stance_balls(
            chain, posture.toes, float(legs.reach.min()) * _LONGEST, legs.lower, legs.upper
        )
        worth = float(ball.min()) * (1 - posture.use)
        if worth > most:
            best, most = posture, worth
    return best


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


def _braces(robot: Robot, mirror: tuple[int | None, ...]) -> tuple[Posture, ...]:
    if not isinstance(robot.mechanism, SerialChain):
        raise TypeError("a robot from a URDF has chains")
    chain, low, high = robot.mechanism, robot.joint_lower, robot.joint_upper
    box = robot.body_hull.min(axis=0), robot.body_hull.max(axis=0)
    reach = _farthest(chain, low, high)
    legs = Legs(chain, low, high, robot.max_torque, reach, robot.weight, mirror, box)
    out: list[Posture] = []
    for mu in WALLS:
        usable = _IN_HAND * mu / SAFETY
        found = bracing_postures(legs, chain.posture, _BRACES, CLEARANCE, usable)
        out += [replace(brace, friction=mu) for brace in found]
    return tuple(out)


def _masses(tree: UrdfTree) -> list[str]:
    """Links that joints move and that weigh nothing, with all that is fixed to them."""
    mass = tree.moving_mass
    empty = [name for name, own in mass.items() if own == 0]
    if not empty:
        return []
    shown = ", ".join(empty[:4]) + (f" and {len(empty) - 4} more" if len(empty) > 4 else "")
    return [f"{len(empty)} of {len(mass)} moving links have no mass: {shown}"]


def _buried(toes: list[Toe], legs: list[LegAtZero], shapes: list[Shape]) -> list[str]:
    """Toes that lie inside the collision geometry of their own last link, by how much."""
    depth: dict[str, float] = {}
    for toe, leg in zip(toes, legs, strict=True):
        own = [shape for shape in shapes if shape.joint == leg.names[-1]]
        deepest = 0.0
        for shape in own:
            along = leg.toe - leg.joints[-1]
            length = float(np.linalg.norm(along))
            if length > 0:
                beyond = (shape.points - leg.toe) @ (along / length) + shape.radius
                deepest = max(deepest, float(beyond.max()))
        if deepest > 1e-3:
            depth[toe.link] = 1e3 * deepest
    if not depth:
        return []
    least, most = f"{min(depth.values()):.0f}", f"{max(depth.values()):.0f}"
    span = most if least == most else f"{least} to {most}"
    where = f"toes {', '.join(depth)} lie {span} mm inside their own feet"
    return [f"{where}, which touch that much earlier; `toe_offset` moves them"]
