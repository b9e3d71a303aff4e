"""From a URDF alone to a robot that can be planned with, and how it may stand and brace."""

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
from climbplan.robots.urdf.proposal.draft import Draft
from climbplan.robots.urdf.proposal.ends import ends_of
from climbplan.robots.urdf.proposal.limbs import (
    FoundLimb,
    FoundLimbs,
    alike,
    body_link,
    legs_among,
    limbs_of,
    limbs_to,
)
from climbplan.robots.urdf.proposal.motors import GRAVITY
from climbplan.robots.urdf.proposal.naming import Named, named
from climbplan.robots.urdf.proposal.nearer import Nearer, nearer_end
from climbplan.robots.urdf.proposal.settled import Proposal, Settled, measured
from climbplan.robots.urdf.proposal.soles import Soles, soles_of
from climbplan.robots.urdf.proposal.standings import standing
from climbplan.robots.urdf.proposal.toes import Toe, spherical, toe_of
from climbplan.robots.urdf.shapes import Shape
from climbplan.schema.robots.urdf.checks import JOINTS_OF_FLAT_FEET
from climbplan.schema.robots.urdf.model import FEWEST_FLAT_FEET, FEWEST_LEGS
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree, read_urdf
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults

_AHEAD = 1.3  # times as far apart front to rear as side to side: how legs tell forward from aside
LYING = (("z", "-x"), ("z", "x"))  # forward and up of a base on its front, whose x was ahead
_LEG_NAMES = "limb {}"
_SHOWN = 4  # names
_LEFT, _RIGHT = (re.compile(rf"(^|_){s[0]}_|{s}", re.IGNORECASE) for s in ("left", "right"))


@dataclass(frozen=True)
class FoundLegs:
    """Which limbs of a URDF are its legs: all that is proposed before postures."""

    draft: Draft
    tree: UrdfTree
    toes: tuple[Toe, ...]  # (N,)
    named: Named
    shapes: list[Shape]
    unread: str  # why there is no collision geometry
    soles: Soles | None = None  # of two legs, which stand on flat feet


def propose(
    urdf: Path, packages: dict[str, str] | None = None, toes: Sequence[str] = ()
) -> Proposal:
    """Look at a URDF.

    A robot with arms stands on all its limbs upright if it can; else on hands and feet, with its
    front or its back down; else on its feet, with its hands on walls. One of two legs stands on
    flat feet.

    toes: links that its legs end in, where not all of its limbs are to be legs, or others.

    Raises SpecError for what is wrong in it and UsageError where nothing can be proposed: too few
    limbs, or no posture in which it stands.
    """
    found = legs_of(urdf, packages, asked=toes)
    if not any(found.named.arms):
        return _standing(found).proposal()
    lying = (legs_of(urdf, packages, axes, toes) for axes in LYING)
    for own in itertools.chain([found], lying):
        try:
            return _standing(own, walls=False).proposal()
        except UsageError:
            continue
    return _standing(found).proposal()


def _standing(found: FoundLegs, walls: bool = True) -> Settled:
    return standing(settled(found), walls)


def settled(found: FoundLegs) -> Settled:
    """Legs with all that does not depend on how the robot stands; raises as `measured`."""
    own = found.draft, found.tree, found.toes, found.named, found.shapes, found.unread
    return replace(measured(*own), soles=found.soles)


def legs_of(
    urdf: Path,
    packages: dict[str, str] | None = None,
    axes: tuple[str, str] | None = None,
    asked: Sequence[str] = (),
) -> FoundLegs:
    """Legs of a URDF, their toes, names and order; raises as `propose` but for postures.

    axes: of the base that point forward and up; left out: up is z, and forward is looked for.
    asked: links that legs end in; left out: they are looked for.
    """
    tree = read_tree(urdf)
    base = body_link(tree)
    found = limbs_to(tree, base, asked) if asked else limbs_of(tree, base)
    limbs = found.limbs
    two = len(limbs) == FEWEST_FLAT_FEET
    _enough(urdf, base, found)
    draft = replace(_draft(urdf, base, limbs, found.shared, packages), asked=tuple(asked))
    shapes, unread = draft.shapes()
    model = draft.model()
    if asked:
        toes = [Toe(link, (0.0, 0.0, 0.0), "as asked for") for link in asked]
    else:
        toes = [toe_of(model, limb.joints[-1].name, limb.end, shapes) for limb in limbs]
    draft.legs = _with_toes(toes)
    legs, groups = _chosen(draft, limbs, urdf, every=bool(asked) or two)
    if not (asked or two) and (ends := _nearer(draft, limbs, legs, shapes)):
        limbs = tuple(ends[i].limb if i in ends else limb for i, limb in enumerate(limbs))
        toes = [ends[i].toe if i in ends else toe for i, toe in enumerate(toes)]
        draft = _draft(urdf, base, limbs, found.shared, packages)
        draft.legs = _with_toes(toes)
        draft.locked |= {name: angle for end in ends.values() for name, angle in end.held.items()}
    draft, hips = _facing(draft, limbs, legs, groups, axes)
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
    own = [toes[i] for i in legs]
    soles = None
    if two:
        soles = soles_of(draft.model(), names.names, own, shapes)
        if soles is None:
            feet = " and ".join(toe.link for toe in own)
            where = f"the collision geometry of the links that {feet} move with"
            if not shapes and not unread:
                where = "the URDF, which is without collision geometry,"
            raise UsageError(
                f"{urdf}: two legs stand on flat feet, and {where} has no level face of 20 mm or "
                f"more{f': {unread}' if unread else ''}"
            )
        own, draft.sole = list(soles.toes), (soles.length, soles.width)
    else:
        own, draft.foot = spherical(draft.model(), names.names, own, shapes)
        if not draft.foot:
            own, draft.foot = ends_of(draft.model(), names.names, own, shapes)
    for name, toe in zip(names.names, own, strict=True):
        draft.legs[name]["toe_offset"] = list(toe.offset)
    return FoundLegs(draft, tree, tuple(own), names, shapes, unread, soles)


def _enough(urdf: Path, base: str, found: FoundLimbs) -> None:
    """Raises UsageError for limbs on which no robot stands."""
    limbs = found.limbs
    least = min((len(limb.joints) for limb in limbs), default=0)
    if len(limbs) >= FEWEST_LEGS:
        return
    if len(limbs) == FEWEST_FLAT_FEET and least >= JOINTS_OF_FLAT_FEET:
        return
    have = ", ".join(f"{limb.end} with {len(limb.joints)}" for limb in limbs) or "none"
    short = ", ".join(f"{end} with {count}" for end, count in found.short.items())
    ours = ""
    if short and len(limbs) + len(found.short) >= FEWEST_LEGS:
        ours = (
            f"; limbs of fewer joints ({short}) are a limit of climbplan, not of the robot: with "
            "the body still, a toe on fewer than three joints moves on a surface, not in a volume, "
            "and plans set toes to either side"
        )
    elif short:
        ours = (
            f"; limbs of fewer joints ({short}) would not make three either: it is no robot with "
            "legs"
        )
    elif len(limbs) == FEWEST_FLAT_FEET:
        ours = (
            "; two legs of fewer joints stand on points, and on one point nothing stands still "
            "while the other leg is lifted"
        )
    if found.still:
        names = ", ".join(found.still[:_SHOWN]) + (", ..." if len(found.still) > _SHOWN else "")
        ours += f"; cannot move, as bounds are alike or not said: {names}"
    raise UsageError(
        f"{urdf}: expected three limbs or more of at least 3 joints that turn, or two of at least "
        f"{JOINTS_OF_FLAT_FEET} with flat feet, carried by the body {base!r}, found {len(limbs)} "
        f"(ending at: {have}){ours}"
    )


def _draft(
    urdf: Path,
    base: str,
    limbs: tuple[FoundLimb, ...],
    shared: tuple[UrdfJoint, ...],
    packages: dict[str, str] | None,
) -> Draft:
    """All limbs as legs with their ends as toes, and what is held."""
    locked = [*shared, *(joint for limb in limbs for joint in limb.locked)]
    return Draft(
        urdf=urdf.resolve(),
        base=base,
        legs={_LEG_NAMES.format(i): {"toe": limb.end} for i, limb in enumerate(limbs)},
        joints={
            j.name: {"max_torque": 1.0, "max_speed": 1.0} for limb in limbs for j in limb.joints
        },
        locked={joint.name: _rest(joint.lower, joint.upper) for joint in locked},
        packages=dict(packages or {}),
        # Until soles are measured
        sole=(0.1, 0.05) if len(limbs) == FEWEST_FLAT_FEET else None,
    )


def _nearer(
    draft: Draft, limbs: tuple[FoundLimb, ...], legs: list[int], shapes: list[Shape]
) -> dict[int, Nearer]:
    """Legs that end before motors too weak for their toes, by their number."""
    model = draft.model()
    share = model.mass() * GRAVITY / len(legs)
    found = {
        i: nearer_end(model, limbs[i], model.leg(_LEG_NAMES.format(i)), share, shapes) for i in legs
    }
    return {i: end for i, end in found.items() if end is not None}


def _with_toes(toes: list[Toe]) -> dict[str, dict[str, Any]]:
    return {
        _LEG_NAMES.format(i): {"toe": toe.link, "toe_offset": list(toe.offset)}
        for i, toe in enumerate(toes)
    }


def read_tree(urdf: Path) -> UrdfTree:
    """The tree of a URDF; raises SpecError for what is wrong in it."""
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
    draft: Draft, limbs: tuple[FoundLimb, ...], urdf: Path, every: bool
) -> tuple[list[int], dict[int, int]]:
    """Limbs that are to be legs, or every one, and the group of alike limbs that each is of."""
    model = draft.model()
    lengths = {i: _length(model.leg(_LEG_NAMES.format(i))) for i in range(len(limbs))}
    grouped = alike(lengths, {i: len(limb.joints) for i, limb in enumerate(limbs)})
    chosen = list(range(len(limbs))) if every else legs_among(grouped)
    if not chosen:
        raise UsageError(f"{urdf}: no three limbs that could be legs")
    return chosen, {i: number for number, group in enumerate(grouped) for i in group}


def _length(leg: LegAtZero) -> float:
    ends = np.concatenate([leg.joints, leg.toe[None]])
    return float(np.linalg.norm(np.diff(ends, axis=0), axis=1).sum())


def _facing(
    draft: Draft,
    limbs: tuple[FoundLimb, ...],
    legs: list[int],
    groups: dict[int, int],
    axes: tuple[str, str] | None,
) -> tuple[Draft, Array]:
    """The draft with the axes that point forward and up, and first joints of legs (N, 3)."""
    for forward, up in [("x", "z"), ("y", "z")] if axes is None else [axes]:
        turned = replace(draft, forward=forward, up=up)
        model = turned.model()
        hips = np.array([model.leg(_LEG_NAMES.format(i)).joints[0] for i in legs])
        wide, long, _ = np.ptp(hips, axis=0)
        one_kind = len({groups[i] for i in legs}) == 1 and len(legs) > 3
        if not (one_kind and wide > _AHEAD * long):
            break
    if axes is None and _sides_swapped([limbs[i].end for i in legs], hips):
        turned = replace(draft, forward=f"-{turned.forward}", up=turned.up)
        hips = hips * [-1.0, -1.0, 1.0]
    return turned, hips


def _sides_swapped(ends: list[str], hips: Array) -> bool:
    """Whether all that is called left is on the right: forward is the other way then."""
    sides = [(bool(_LEFT.search(end)), bool(_RIGHT.search(end))) for end in ends]
    told = [(left, x) for (left, right), x in zip(sides, hips[:, 0], strict=True) if left != right]
    return bool(told) and all((x > 0) == left for left, x in told)
