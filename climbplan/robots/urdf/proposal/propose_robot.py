"""Generation of a robot configuration from a URDF alone: its legs, its stances and its braces."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import SpecError, UsageError
from climbplan.robots.urdf.pinocchio_model import LegAtZero
from climbplan.robots.urdf.proposal.candidate_stances import find_candidate_stances
from climbplan.robots.urdf.proposal.draft import Draft
from climbplan.robots.urdf.proposal.leg_naming import LegNaming, name_legs
from climbplan.robots.urdf.proposal.limb_truncation import TruncatedLimb, truncate_weak_limb
from climbplan.robots.urdf.proposal.limbs import (
    LimbChain,
    LimbChains,
    find_body_link,
    find_limbs,
    find_limbs_to,
    group_similar_limbs,
    select_legs,
)
from climbplan.robots.urdf.proposal.motors import GRAVITY
from climbplan.robots.urdf.proposal.prepared_robot import (
    PreparedRobot,
    RobotProposal,
    prepare_robot,
)
from climbplan.robots.urdf.proposal.soles import Soles, find_soles
from climbplan.robots.urdf.proposal.toe_placement import place_toes_on_surface
from climbplan.robots.urdf.proposal.toes import (
    NEGLIGIBLE_RANGE,
    Toe,
    build_toe,
    center_on_spherical_feet,
    find_toe,
)
from climbplan.robots.urdf.shapes import CollisionShape
from climbplan.schema.robots.urdf.checks import FEWEST_JOINTS, JOINTS_OF_FLAT_FEET
from climbplan.schema.robots.urdf.meshes import find_mesh
from climbplan.schema.robots.urdf.model import FEWEST_FLAT_FEET, FEWEST_LEGS
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree, read_urdf
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults

_MIN_ASPECT_RATIO = 1.3  # of leg spacing, front to rear over side to side, that tells forward
PRONE_AND_SUPINE_AXES = (("z", "-x"), ("z", "x"))
"""Forward and up of a base whose x was forward, on its front and on its back."""
_LEG_NAME = "limb {}"
_MAX_NAMES_SHOWN = 4
_MIN_LEVER_RATIO = 0.02  # of a toe about its last joint, over the length of the limb
_LEFT, _RIGHT = (re.compile(rf"(^|_){s[0]}_|{s}", re.IGNORECASE) for s in ("left", "right"))


@dataclass(frozen=True)
class DetectedLegs:
    """The legs of a URDF with their toes: the part of a proposal that precedes its postures."""

    draft: Draft
    tree: UrdfTree
    toes: tuple[Toe, ...]  # (N,)
    naming: LegNaming
    shapes: list[CollisionShape]
    geometry_error: str  # why there is no collision geometry; empty if there is
    soles: Soles | None = None  # of two legs, which stand on flat feet


def propose_robot(
    urdf: Path, packages: dict[str, str] | None = None, toes: Sequence[str] = ()
) -> RobotProposal:
    """Propose a robot configuration for a URDF.

    A robot with two legs stands on flat feet, whether it has arms or not. One with arms and other
    feet stands upright on all of its limbs if it can. Else it stands on hands and feet with its
    front or its back down, and else on its feet with its hands on walls.

    Args:
        urdf: The file.
        packages: Folders of `package://` names in it; None for none.
        toes: Links that its legs end in. Empty: the legs are the largest group of similar limbs.

    Raises:
        SpecError: The URDF is wrong.
        UsageError: Nothing can be proposed: too few limbs, or no posture in which it stands.
    """
    upright = detect_legs(urdf, packages, requested_toes=toes)
    if not any(upright.naming.is_arm):
        return _find_stances(upright).build_best_proposal()
    if (feet := _find_two_feet(upright)) and not toes:
        try:
            standing = _find_stances(detect_legs(urdf, packages, requested_toes=feet))
        except UsageError:
            pass  # its feet are not flat, or it does not stand on them alone
        else:
            proposal = standing.build_proposal()
            return replace(proposal, assumptions=(*proposal.assumptions, _describe_hands(upright)))
    lying = (detect_legs(urdf, packages, axes, toes) for axes in PRONE_AND_SUPINE_AXES)
    for legs in itertools.chain([upright], lying):
        try:
            return _find_stances(legs, walls=False).build_proposal()
        except UsageError:
            continue
    return _find_stances(upright).build_proposal()


def _find_two_feet(legs: DetectedLegs) -> tuple[str, ...]:
    """Return the links that two legs below arms end in; empty where legs are not two or weak."""
    naming, model = legs.naming, legs.draft.build_model()
    feet = [
        toe.link
        for name, toe, is_arm in zip(naming.names, legs.toes, naming.is_arm, strict=True)
        if not is_arm and len(model.read_leg(name).names) >= JOINTS_OF_FLAT_FEET
    ]
    num_legs = sum(not is_arm for is_arm in naming.is_arm)
    return tuple(feet) if num_legs == len(feet) == FEWEST_FLAT_FEET else ()


def _describe_hands(legs: DetectedLegs) -> str:
    """Return the note on the arms of a robot that stands on its two feet."""
    links = ",".join(toe.link for toe in legs.toes)
    return f"it stands on its two feet, and its arms are locked; `--toes {links}` has it use them"


def _find_stances(legs: DetectedLegs, walls: bool = True) -> PreparedRobot:
    """Return the robot with its candidate stances; raises UsageError if it has none."""
    return find_candidate_stances(prepare_detected_legs(legs), walls)


def prepare_detected_legs(legs: DetectedLegs) -> PreparedRobot:
    """Compute all that does not depend on how the robot stands.

    Raises:
        UsageError: The links have no mass.
    """
    robot = prepare_robot(
        legs.draft, legs.tree, legs.toes, legs.naming, legs.shapes, legs.geometry_error
    )
    return replace(robot, soles=legs.soles)


def detect_legs(
    urdf: Path,
    packages: dict[str, str] | None = None,
    axes: tuple[str, str] | None = None,
    requested_toes: Sequence[str] = (),
) -> DetectedLegs:
    """Find the legs of a URDF, their toes, names and order.

    Args:
        urdf: The file.
        packages: Folders of `package://` names in it; None for none.
        axes: Axes of the base that point forward and up. None: up is z, and forward is inferred
            from the places of the legs.
        requested_toes: Links that legs end in. Empty: they are inferred.

    Raises:
        SpecError: The URDF is wrong.
        UsageError: It has too few limbs, or two legs without flat feet.
    """
    tree = read_tree(urdf)
    base = find_body_link(tree)
    chains = find_limbs_to(tree, base, requested_toes) if requested_toes else find_limbs(tree, base)
    limbs = chains.limbs
    is_biped = len(limbs) == FEWEST_FLAT_FEET
    _require_enough_limbs(urdf, base, chains)
    draft = _build_draft(urdf, base, limbs, chains.shared, packages)
    missing = _find_missing_meshes(tree, draft.packages)
    draft = replace(draft, requested_toes=tuple(requested_toes), missing_meshes=missing)
    shapes, _ = draft.read_shapes()
    if requested_toes:
        toes = [Toe(link, (0.0, 0.0, 0.0), "as asked for") for link in requested_toes]
    else:
        model = draft.build_model()
        toes = [find_toe(model, limb.joints[-1].name, limb.end, shapes) for limb in limbs]
    draft.legs = _build_leg_sections(toes)
    if not requested_toes and not is_biped:
        limbs, toes, draft = _lock_idle_ends(draft, limbs, toes, chains.shared)
        shapes, _ = draft.read_shapes()
    keep_all = bool(requested_toes) or is_biped
    legs, groups = _select_legs(draft, limbs, urdf, keep_all)
    if not keep_all and (cut := _truncate_weak_limbs(draft, limbs, legs, shapes)):
        limbs = tuple(cut[i].limb if i in cut else limb for i, limb in enumerate(limbs))
        toes = [cut[i].toe if i in cut else toe for i, toe in enumerate(toes)]
        draft = _build_draft(urdf, base, limbs, chains.shared, packages)
        draft = replace(draft, missing_meshes=missing)
        draft.legs = _build_leg_sections(toes)
        draft.locked |= {
            name: angle for limb in cut.values() for name, angle in limb.locked_angles.items()
        }
    draft, hips = _choose_forward_axis(draft, limbs, legs, groups, axes)
    links = [toes[i].link for i in legs]
    naming = name_legs(hips, links, [groups[i] for i in legs])
    legs = [legs[i] for i in naming.order]
    draft.legs = {
        name: {"toe": toes[i].link, "toe_offset": list(toes[i].offset)}
        for name, i in zip(naming.names, legs, strict=True)
    }
    _unlock_unrelated_joints(draft, tree, base, [limbs[i] for i in legs])
    leg_toes = tuple(toes[i] for i in legs)
    return _place_toes(DetectedLegs(draft, tree, leg_toes, naming, *draft.read_shapes()), is_biped)


def _find_missing_meshes(tree: UrdfTree, packages: dict[str, str]) -> tuple[str, ...]:
    """Return the collision meshes of a URDF without a file, by the names that it gives them."""
    missing = []
    for name, _ in dict.fromkeys(m for link in tree.links.values() for m in link.collision_meshes):
        try:
            find_mesh(name, tree.path, packages, Path())
        except UrdfFault:
            missing.append(name)
    return tuple(dict.fromkeys(missing))


def _lock_idle_ends(
    draft: Draft, limbs: tuple[LimbChain, ...], toes: list[Toe], shared: tuple[UrdfJoint, ...]
) -> tuple[tuple[LimbChain, ...], list[Toe], Draft]:
    """Return limbs, toes and draft with last joints locked that hardly move their toes.

    These are joints of negligible range, and joints on whose axis the toe lies, as of a wheel.
    The toe is then on the geometry of the links beyond, as far as it is known.
    """
    while True:
        model = draft.build_model()
        legs = [model.read_leg(_LEG_NAME.format(i)) for i in range(len(limbs))]
        idle = {
            i
            for i, (limb, leg) in enumerate(zip(limbs, legs, strict=True))
            if len(limb.joints) > FEWEST_JOINTS and _is_last_joint_idle(limb, leg)
        }
        if not idle:
            return limbs, toes, draft
        limbs = tuple(
            LimbChain(limb.joints[:-1], (limb.joints[-1], *limb.locked)) if i in idle else limb
            for i, limb in enumerate(limbs)
        )
        shorter = _build_draft(draft.urdf, draft.base, limbs, shared, draft.packages)
        shorter.missing_meshes = draft.missing_meshes
        shapes, _ = shorter.read_shapes()
        model, toes = shorter.build_model(), list(toes)
        for i in idle:
            joint, end = limbs[i].joints[-1].name, limbs[i].end
            toe = find_toe(model, joint, end, shapes)
            if not any(shape.joint == joint for shape in shapes) and toe.link == end:
                name = limbs[i].locked[0].name
                toe = build_toe(model, end, legs[i].toe, f"where {name} turns, which is locked")
            toes[i] = toe
        shorter.legs = _build_leg_sections(toes)
        draft = shorter


def _is_last_joint_idle(limb: LimbChain, leg: LegAtZero) -> bool:
    """Return whether the last joint hardly turns, or hardly moves the toe as it turns."""
    joint = limb.joints[-1]
    lever = float(np.linalg.norm(np.cross(leg.toe - leg.joints[-1], leg.axes[-1])))
    return (
        joint.upper - joint.lower < NEGLIGIBLE_RANGE
        or lever < _MIN_LEVER_RATIO * _compute_limb_length(leg)
    )


def _unlock_unrelated_joints(
    draft: Draft, tree: UrdfTree, base: str, legs: list[LimbChain]
) -> None:
    """Remove locked joints from the draft that neither carry legs nor lie beyond their ends."""
    carrying = {joint.name for leg in legs for joint in tree.way_to(leg.end, base) or []}
    beyond = {joint.name for leg in legs for joint in leg.locked}
    draft.locked = {
        name: angle for name, angle in draft.locked.items() if name in carrying or name in beyond
    }


def _place_toes(legs: DetectedLegs, is_biped: bool) -> DetectedLegs:
    """Return the legs with toes where they touch: soles, spherical feet or surface points.

    Raises UsageError for a biped without flat feet.
    """
    draft, names, shapes = legs.draft, legs.naming.names, legs.shapes
    toes, soles = list(legs.toes), None
    if is_biped:
        soles = find_soles(draft.build_model(), names, toes, shapes)
        if soles is None:
            raise UsageError(_describe_missing_soles(legs))
        toes, draft.sole = list(soles.toes), (soles.length, soles.width)
    else:
        toes, draft.foot = center_on_spherical_feet(draft.build_model(), names, toes, shapes)
        if not draft.foot:
            toes, draft.foot = place_toes_on_surface(draft.build_model(), names, toes, shapes)
    for name, toe in zip(names, toes, strict=True):
        draft.legs[name]["toe_offset"] = list(toe.offset)
    return replace(legs, toes=tuple(toes), soles=soles)


def _describe_missing_soles(legs: DetectedLegs) -> str:
    """Return the message for a biped without flat feet."""
    feet = " and ".join(toe.link for toe in legs.toes)
    where = f"the collision geometry of the links that {feet} move with"
    if not legs.shapes and not legs.geometry_error:
        where = "the URDF, which is without collision geometry,"
    reason = f": {legs.geometry_error}" if legs.geometry_error else ""
    return (
        f"{legs.tree.path}: two legs stand on flat feet, and {where} has no level face of 20 mm or "
        f"more{reason}"
    )


def _require_enough_limbs(urdf: Path, base: str, chains: LimbChains) -> None:
    """Raise UsageError if no robot stands on these limbs."""
    limbs = chains.limbs
    min_joints = min((len(limb.joints) for limb in limbs), default=0)
    if len(limbs) >= FEWEST_LEGS:
        return
    if len(limbs) == FEWEST_FLAT_FEET and min_joints >= JOINTS_OF_FLAT_FEET:
        return
    ends = ", ".join(f"{limb.end} with {len(limb.joints)}" for limb in limbs) or "none"
    too_short = ", ".join(f"{end} with {count}" for end, count in chains.too_short.items())
    hint = ""
    if too_short and len(limbs) + len(chains.too_short) >= FEWEST_LEGS:
        hint = (
            f"; limbs of fewer joints ({too_short}) are a limit of climbplan, not of the robot: "
            "with the body still, a toe on fewer than three joints moves on a surface, not in a "
            "volume, and plans set toes to either side"
        )
    elif too_short:
        hint = (
            f"; limbs of fewer joints ({too_short}) would not make three either: it is no robot "
            "with legs"
        )
    elif len(limbs) == FEWEST_FLAT_FEET:
        hint = (
            "; two legs of fewer joints stand on points, and on one point nothing stands still "
            "while the other leg is lifted"
        )
    if chains.immovable:
        names = ", ".join(chains.immovable[:_MAX_NAMES_SHOWN])
        names += ", ..." if len(chains.immovable) > _MAX_NAMES_SHOWN else ""
        hint += f"; cannot move, as bounds are alike or not said: {names}"
    raise UsageError(
        f"{urdf}: expected three limbs or more of at least 3 joints that turn, or two of at least "
        f"{JOINTS_OF_FLAT_FEET} with flat feet, carried by the body {base!r}, found {len(limbs)} "
        f"(ending at: {ends}){hint}"
    )


def _build_draft(
    urdf: Path,
    base: str,
    limbs: tuple[LimbChain, ...],
    shared: tuple[UrdfJoint, ...],
    packages: dict[str, str] | None,
) -> Draft:
    """Return a draft with all limbs as legs, their ends as toes, and the other joints locked."""
    locked = [*shared, *(joint for limb in limbs for joint in limb.locked)]
    return Draft(
        urdf=urdf.resolve(),
        base=base,
        legs={_LEG_NAME.format(i): {"toe": limb.end} for i, limb in enumerate(limbs)},
        joints={
            j.name: {"max_torque": 1.0, "max_speed": 1.0} for limb in limbs for j in limb.joints
        },
        locked={joint.name: _choose_locked_angle(joint.lower, joint.upper) for joint in locked},
        packages=dict(packages or {}),
        # Until soles are measured
        sole=(0.1, 0.05) if len(limbs) == FEWEST_FLAT_FEET else None,
    )


def _truncate_weak_limbs(
    draft: Draft, limbs: tuple[LimbChain, ...], legs: list[int], shapes: list[CollisionShape]
) -> dict[int, TruncatedLimb]:
    """Return the legs that end before motors too weak for their toes, by limb number."""
    model = draft.build_model()
    load = model.compute_mass() * GRAVITY / len(legs)
    cut = {
        i: truncate_weak_limb(model, limbs[i], model.read_leg(_LEG_NAME.format(i)), load, shapes)
        for i in legs
    }
    return {i: limb for i, limb in cut.items() if limb is not None}


def _build_leg_sections(toes: list[Toe]) -> dict[str, dict[str, Any]]:
    """Return the section of each limb, by its provisional name."""
    return {
        _LEG_NAME.format(i): {"toe": toe.link, "toe_offset": list(toe.offset)}
        for i, toe in enumerate(toes)
    }


def read_tree(urdf: Path) -> UrdfTree:
    """Read the tree of a URDF.

    Raises:
        SpecError: The URDF is wrong.
    """
    try:
        tree = read_urdf(urdf)
    except (UrdfFault, UrdfFaults) as error:
        faults = error.faults if isinstance(error, UrdfFaults) else [error]
        from climbplan.errors import SpecMistake

        mistakes = [SpecMistake("", fault.message, fault.line) for fault in faults]
        raise SpecError(str(urdf), mistakes) from error
    return tree


def _choose_locked_angle(lower: float, upper: float) -> float:
    """Return zero [deg], or the middle of bounds [rad] that exclude it."""
    return 0.0 if lower <= 0 <= upper else round(float(np.rad2deg((lower + upper) / 2)), 2)


def _select_legs(
    draft: Draft, limbs: tuple[LimbChain, ...], urdf: Path, keep_all: bool
) -> tuple[list[int], dict[int, int]]:
    """Return the limbs that are legs, and the number of each limb's group of similar limbs."""
    model = draft.build_model()
    lengths = {
        i: _compute_limb_length(model.read_leg(_LEG_NAME.format(i))) for i in range(len(limbs))
    }
    groups = group_similar_limbs(lengths, {i: len(limb.joints) for i, limb in enumerate(limbs)})
    legs = list(range(len(limbs))) if keep_all else select_legs(groups)
    if not legs:
        raise UsageError(f"{urdf}: no three limbs that could be legs")
    return legs, {i: number for number, group in enumerate(groups) for i in group}


def _compute_limb_length(leg: LegAtZero) -> float:
    """Return the length of the line from joint to joint to the toe [m]."""
    points = np.concatenate([leg.joints, leg.toe[None]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _choose_forward_axis(
    draft: Draft,
    limbs: tuple[LimbChain, ...],
    legs: list[int],
    groups: dict[int, int],
    axes: tuple[str, str] | None,
) -> tuple[Draft, Array]:
    """Return the draft with its forward and up axes, and the first joints of legs (N, 3) [m].

    axes: forward and up, if they are given.
    """
    for forward, up in [("x", "z"), ("y", "z")] if axes is None else [axes]:
        oriented = replace(draft, forward=forward, up=up)
        model = oriented.build_model()
        hips = np.array([model.read_leg(_LEG_NAME.format(i)).joints[0] for i in legs])
        wide, long, _ = np.ptp(hips, axis=0)
        is_one_kind = len({groups[i] for i in legs}) == 1 and len(legs) > 3
        if not (is_one_kind and wide > _MIN_ASPECT_RATIO * long):
            break
    if axes is None and _are_sides_swapped([limbs[i].end for i in legs], hips):
        oriented = replace(draft, forward=f"-{oriented.forward}", up=oriented.up)
        hips = hips * [-1.0, -1.0, 1.0]
    return oriented, hips


def _are_sides_swapped(ends: list[str], hips: Array) -> bool:
    """Return whether all limbs called left are on the right: forward is the other way then."""
    sides = [(bool(_LEFT.search(end)), bool(_RIGHT.search(end))) for end in ends]
    named = [(left, x) for (left, right), x in zip(sides, hips[:, 0], strict=True) if left != right]
    return bool(named) and all((x > 0) == left for left, x in named)
