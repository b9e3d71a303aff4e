"""Whether a refusal of `bench zoo` stands up to drawn postures and statics of all links.

What every plan of a column has to have is looked for: for each limb a posture in which the others
hold the robot while it is lifted (`wall`: for one limb). Postures are drawn anywhere first, then
about the best that was found. A limb without such a posture makes the refusal right as far as
drawing can tell; how near the best comes is told in N m or mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.bench.zoo.second.stances import Limbs, Stance, Surface, anywhere, beside, onto
from climbplan.bench.zoo.second.statics import Load, least_load
from climbplan.errors import SpecError, UsageError
from climbplan.robots.urdf.pinocchio_model import urdf_model
from climbplan.robots.urdf.proposal.braces import SAFETY, WALLS
from climbplan.robots.urdf.proposal.motors import motors_of
from climbplan.robots.urdf.proposal.proposing import FoundLegs, legs_of, propose
from climbplan.robots.urdf.proposal.settled import FLOOR, GRAVITY
from climbplan.robots.urdf.proposal.touching import Parts, parts_of

COUNT = 150  # postures drawn anywhere that have their toes on surfaces, and are free of all else
_MOST = 20  # times as many that are drawn for them
_ENOUGH = 1 / 1.2  # of the torque limits, as the specs ask for S_tau of 1.2
_NEARER = 2 / 3  # as many again about the best, for each limb
_SPREADS = (0.5, 0.05)  # [rad] about it, from the first to the last
_STAIR = 0.05  # [m]: what the zoo's are at least
CLIMBS = ("ground", "stairs", "chimney", "wall")


@dataclass(frozen=True)
class Look:
    """What the second method says."""

    verdict: str  # "refusal right", "found one", "not decided", "limit of ours", "not looked at"
    words: str
    reached: int = 0  # postures with every toe on its surface and all else clear
    drawn: int = 0


def second_look(urdf: Path, column: str, words: str, seed: int, count: int = COUNT) -> Look:
    """Look again at a refused column; words: of the refusal."""
    if column not in CLIMBS:
        if words.startswith("no spec"):
            return Look("limit of ours", "legs of as many joints each, in pairs, walk at speed")
        return Look("not looked at", "walks at speed are no question of postures")
    try:
        found = legs_of(urdf, axes=_axes(urdf))
    except (SpecError, UsageError) as error:
        told = str(error).partition("\n")[0].replace(str(urdf), urdf.name)
        return Look("limit of ours", told)
    limbs = _limbs(found)
    surfaces, mu = surfaces_of(limbs, found.named.arms, column)
    parts = _parts(found, limbs)
    return looked(limbs, surfaces, mu, column == "wall", seed, count, parts)


def _axes(urdf: Path) -> tuple[str, str] | None:
    """The axes of the base that point forward and up as the robot was planned with, if it was."""
    try:
        draft = propose(urdf).draft
    except UsageError:
        return None
    return draft.forward, draft.up


def surfaces_of(
    limbs: Limbs, arms: tuple[bool, ...], column: str
) -> tuple[tuple[Surface, ...], float]:
    """Where each limb's toe has to be, and the friction that may be used."""
    sides = np.where(limbs.hips[:, 0] < 0, -1.0, 1.0)
    if column in ("chimney", "wall"):
        return tuple(Surface(0, float(side)) for side in sides), max(WALLS) / SAFETY
    raised = np.zeros(len(sides))
    if column == "stairs":  # the front half is one stair up
        raised = np.where(limbs.hips[:, 1] > np.median(limbs.hips[:, 1]), _STAIR, 0.0)
    surfaces = tuple(
        Surface(0, float(side)) if arm else Surface(2, -1.0, float(up))
        for side, arm, up in zip(sides, arms, raised, strict=True)
    )
    return surfaces, FLOOR / SAFETY


def looked(
    limbs: Limbs,
    surfaces: tuple[Surface, ...],
    mu: float,
    any_limb: bool,
    seed: int,
    count: int = COUNT,
    parts: Parts | None = None,
) -> Look:
    """Draw postures, and tell what they say of a refusal.

    any_limb: one limb that may be lifted is enough, in place of each. parts: that must not touch.
    """
    rng = np.random.default_rng(seed)
    number = len(limbs.names)
    best: list[tuple[Load, Stance] | None] = [None] * number
    reached, near, out, total = 0, np.inf, np.inf, 0

    def tried(stance: Stance, lifted: int) -> None:
        others = tuple(limb for limb in range(number) if limb != lifted)
        load = least_load(limbs, surfaces, stance, others, mu)
        known = best[lifted]
        if known is None or load.share < known[0].share:
            if parts is not None and parts.touching(stance.angles):
                return
            best[lifted] = load, stance

    whole = 0
    while whole < count and total < _MOST * count:
        stance = onto(limbs, surfaces, *anywhere(limbs, rng))
        total += 1
        near = min(near, stance.missed)
        if stance.missed > 0:
            continue
        reached += 1
        out = min(out, stance.beyond)
        if stance.beyond == 0 and (parts is None or not parts.touching(stance.angles)):
            whole += 1
            for lifted in range(number):
                tried(stance, lifted)
    more = int(_NEARER * count)
    for lifted in range(number):
        for step in range(more):
            known = best[lifted]
            if known is None or known[0].share <= _ENOUGH:
                break
            spread = _SPREADS[0] * (_SPREADS[1] / _SPREADS[0]) ** (step / more)
            stance = onto(limbs, surfaces, *beside(limbs, known[1], spread, rng))
            total += 1
            if stance.missed == stance.beyond == 0:
                whole += 1
                tried(stance, lifted)
    if whole == 0:
        words = f"toes miss their surfaces by {1e3 * near:.0f} mm or more"
        if reached:
            words = f"joints are {1e3 * out:.0f} mm or more beyond surfaces"
        if out == 0:
            words = "parts of the robot touch in every posture that was drawn"
        return Look("not decided", words, whole, total)
    return _judged(limbs, best, any_limb, whole, total)


def _judged(
    limbs: Limbs,
    best: list[tuple[Load, Stance] | None],
    any_limb: bool,
    reached: int,
    total: int,
) -> Look:
    loads = [one[0] for one in best if one is not None]
    choose = min if any_limb else max
    limb = choose(range(len(loads)), key=lambda i: loads[i].share)
    load, name = loads[limb], limbs.names[limb]
    if load.share <= _ENOUGH:
        words = f"postures hold with a limb lifted, with {load.share:.0%} of the torque limits"
        return Look("found one", words, reached, total)
    if np.isinf(load.share):
        words = f"with {name} lifted no forces within friction hold it"
        return Look("refusal right", words, reached, total)
    has = _ENOUGH * load.limit
    words = (
        f"with {name} lifted {load.joint} needs {load.torque:.3g} N m at the least that was found, "
        f"{load.torque - has:.2g} N m more than the {has:.3g} N m that may be used"
    )
    return Look("refusal right", words, reached, total)


def _parts(found: FoundLegs, limbs: Limbs) -> Parts | None:
    """What of the robot may touch itself, None without collision geometry."""
    if not found.shapes:
        return None
    bounds = {
        joint.name: (max(joint.lower, -np.pi), min(joint.upper, np.pi))
        for own in limbs.joints
        for joint in own
    }
    return parts_of(urdf_model(found.draft.robot(meshes=True)), bounds)


def _limbs(found: FoundLegs) -> Limbs:
    """The robot in Pinocchio's hands, with limits as the proposal takes them."""
    model = urdf_model(found.draft.robot())
    limbs = Limbs(model, {j.name: 1.0 for own in model.robot.joints.values() for j in own})
    legs = [model.leg(name) for name in limbs.names]
    reach = np.array(
        [
            float(np.linalg.norm(np.diff([*leg.joints, leg.toe], axis=0), axis=1).sum())
            for leg in legs
        ]
    )
    joints = [tuple(found.tree.joints[name] for name in leg.names) for leg in legs]
    motors = motors_of(joints, reach, model.mass() * GRAVITY)
    limits = {
        joint.name: float(motors.joints[joint.name].max_torque or joint.effort or 0.0)
        for own in joints
        for joint in own
    }
    return Limbs(model, limits)
