"""Grips at the instants and on the way: cones, gripping force, moments, wrists, pull-out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.grips import (
    PARTS,
    Hands,
    Holds,
    gripper_frames,
    hands_at,
    holds_of,
    spine_bounds,
    wrist_axes,
)
from climbplan.climb.check.self_collision import segments_apart
from climbplan.climb.check.subject import Subject
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.grips import GripPlan
from climbplan.robots.gripper import WRIST_JOINTS, Gripper
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, faults_check, judge_worst

_TOLD = 0.02  # [m] room up to which it is measured


def grips_apart(subject: Subject, gripper: Gripper, holds: Holds) -> Check:
    """Room between grippers at every instant, of every two limbs that hold on [m].

    Each gripper is a T, as thick as a limb: from the wrist to the grip's centre, and from finger
    to finger.
    """
    plan = subject.plan
    instants, names = plan.instants, plan.robot.limb_names
    wrists = instants.toes
    palms = wrists - gripper.length * instants.normal
    fingers = gripper.finger_span / 2 * holds.axis[instants.region]
    parts = (
        np.stack([wrists, palms], axis=2),
        np.stack([palms - fingers, palms + fingers], axis=2),
    )  # (K, N, 2, 3)
    thick = 2 * plan.robot.limb_radius
    pairs = list(itertools.combinations(range(len(names)), 2))
    room = np.full((instants.count, len(pairs)), _TOLD)
    for column, (one, other) in enumerate(pairs):
        both = np.flatnonzero(instants.contact[:, one] & instants.contact[:, other])
        for a, b in itertools.product(parts, parts):
            away = segments_apart(a[both, one], b[both, other], thick + _TOLD) - thick
            room[both, column] = np.minimum(room[both, column], away)

    def where(k: int, column: int) -> str:
        one, other = pairs[column]
        return f"{subject.at(k)}, {names[one]} and {names[other]}"

    least = float(room.min())
    words = "at least " if least >= _TOLD else ""
    return judge_worst("grip.apart", -room, where, f"{words}{1e3 * least:.1f} mm between grippers")


_NO_SHEAR = 1e-6  # of the weight: less is rounding of forces that are zero
_BISECTIONS = 60
_FAR = 1e6  # [N] a pull that counts as any


def gripper_check(plan: ClimbPlan) -> Check:
    """Grippers, holds and the model of spines that can be; passes where there are none."""
    faults: list[str] = []
    gripper, grips = plan.robot.gripper, plan.grips
    for surface in plan.terrain.surfaces:
        if isinstance(surface, Region) and surface.hold is not None:
            hold = surface.hold
            unit = abs(np.linalg.norm(hold.axis) - 1) < 1e-6
            if not (unit and abs(hold.axis @ surface.normal) < 1e-6):
                faults.append(f"fingers' axis on {surface.name!r} is no direction in it")
            if not -np.pi / 2 - 1e-9 <= hold.undercut < np.pi / 2:
                faults.append(f"undercut of {surface.name!r} is not within -90 to 90 deg")
    if gripper is not None and grips is not None:
        positive = {
            "length": gripper.length,
            "finger_span": gripper.finger_span,
            "wrist_max_torque": gripper.wrist_max_torque.min(),
            "wrist_upper - wrist_lower": (gripper.wrist_upper - gripper.wrist_lower).min(),
            "model noise": grips.model.noise,
            "model length": grips.model.length,
            "model scale": grips.model.scale.min(),
        }
        faults += [f"{name} is not above zero" for name, value in positive.items() if not value > 0]
        if not gripper.max_force >= 0:
            faults.append("max_force is negative")
        if not 0 < grips.risk < 1:
            faults.append(f"risk {grips.risk:g} is not between 0 and 1")
        faults += [
            f"{surface.name!r} does not stand off by the gripper's length"
            for index, surface in enumerate(plan.terrain.surfaces)
            if isinstance(surface, Region)
            and plan.terrain.allowed[:, index].any()
            and abs(surface.standoff - gripper.length) > 1e-6
        ]
    return faults_check("grip.data", faults)


def grip_checks(subject: Subject) -> Iterator[Check]:
    """All checks of a plan with grippers."""
    plan = subject.plan
    gripper, grips = plan.robot.gripper, plan.grips
    if gripper is None or grips is None:
        return
    holds = holds_of(plan)
    bounds = spine_bounds(grips.model, grips.risk, holds)
    off = np.abs(bounds - grips.spines)
    yield judge_worst("grip.spines", off, lambda r: f"on {plan.terrain.surfaces[r].name!r}")
    hands = _hands(subject, gripper, grips, holds, bounds, np.zeros(plan.instants.contact.shape))
    yield from _cones(subject, hands)
    yield from _gripping(subject, gripper, grips, hands)
    yield from _wrists(subject, gripper, grips, holds)
    yield grips_apart(subject, gripper, holds)
    yield _pull_out(subject, grips, further_pull(subject, gripper, grips))
    yield _factors(subject, gripper, grips, hands, bounds[plan.instants.region])


def _cones(subject: Subject, hands: Hands) -> Iterator[Check]:
    """Palm and fingers press, and shear no more than friction and spines hold over S_mu."""
    contact = subject.plan.instants.contact[..., None]

    def where(k: int, limb: int, part: int) -> str:
        return f"{subject.at(k)}, {subject.limb(limb)} {PARTS[part]}"

    lifts = np.where(contact, -hands.pressure, -np.inf) / subject.weight
    yield judge_worst("grip.press", lifts, where)
    asked = subject.plan.limits.safety_friction
    loaded = contact & (hands.shear > _NO_SHEAR * subject.weight)
    excess = np.where(contact, hands.shear - hands.held / asked, -np.inf) / subject.weight
    use = np.where(loaded, hands.share(), 0.0)
    margin = f"S_mu {1 / use.max():.2f}" if use.any() else "no shear"
    yield judge_worst("grip.shear", excess, where, margin, used=use * asked)


def _gripping(subject: Subject, gripper: Gripper, grips: GripPlan, hands: Hands) -> Iterator[Check]:
    """Gripping force within its limit over S_tau; no moment that fingers cannot carry."""
    plan = subject.plan
    force, contact = grips.instants.grip, plan.instants.contact
    limit = gripper.max_force / plan.limits.safety_torque
    excess = np.maximum(force - limit, -force)
    yield judge_worst(
        "grip.force",
        excess,
        subject.at,
        margin=f"at most {force.max():.1f} of {gripper.max_force:.4g} N",
        used=force / limit if limit > 0 else np.zeros_like(force),
    )
    # Without contact nothing is left at all
    idle = grips.instants.packed
    left = np.where(contact, 0.0, np.abs(idle).max(axis=-1))
    size = np.linalg.norm(grips.instants.moment, axis=-1)
    yield judge_worst(
        "grip.moment",
        np.maximum(hands.stray, left),
        subject.at,
        margin=f"moments up to {size.max():.2f} N m",
    )


def _wrists(subject: Subject, gripper: Gripper, grips: GripPlan, holds: Holds) -> Iterator[Check]:
    """Wrists hold the grippers square on their holds, within bounds and torques."""
    plan = subject.plan
    link = subject.limbs.last_link()
    frames = gripper_frames(gripper, link, grips.wrist_angles)
    normal, axis = plan.instants.normal, holds.axis[plan.instants.region]
    aside = np.linalg.norm(frames[..., 0, :] + normal, axis=-1)
    closing = frames[..., 1, :]
    # Two fingers may be the other way round.
    turned = np.minimum(
        np.linalg.norm(closing - axis, axis=-1), np.linalg.norm(closing + axis, axis=-1)
    )
    yield judge_worst("wrist.square", np.maximum(aside, turned), subject.at)

    def where(k: int, limb: int, joint: int) -> str:
        return f"{subject.at(k)}, {subject.limb(limb)} {WRIST_JOINTS[joint]}"

    angles = grips.wrist_angles
    over = np.maximum(gripper.wrist_lower - angles, angles - gripper.wrist_upper)
    half = (gripper.wrist_upper - gripper.wrist_lower) / 2
    margin = f"{np.rad2deg(-over.max()):.1f} deg"
    yield judge_worst("wrist.bounds", over, where, margin, used=1 + over / half)

    torque = np.einsum("knji,kni->knj", wrist_axes(link, angles), subject.wrist_moment)
    torque = np.where(plan.instants.contact[..., None], torque, 0.0)
    yield judge_worst("wrist.from_forces", np.abs(torque - grips.wrist_torque), where)
    use = np.abs(torque) / gripper.wrist_max_torque
    asked = plan.limits.safety_torque
    yield judge_worst(
        "wrist.torque",
        use - 1 / asked,
        where,
        margin=f"at most {np.abs(torque).max():.2f} N m",
        used=use * asked,
    )


def _hands(
    subject: Subject, gripper: Gripper, grips: GripPlan, holds: Holds, bounds: Array, pull: Array
) -> Hands:
    """What palms and fingers do at the instants, pulled off their surfaces by (K, N) more [N]."""
    plan, instants = subject.plan, subject.plan.instants
    return hands_at(
        plan.forces.force - pull[..., None] * instants.normal,
        grips.instants,
        instants.normal,
        instants.region,
        holds,
        bounds,
        gripper.finger_span,
    )


def friction_in_hand(subject: Subject, gripper: Gripper, grips: GripPlan) -> Array:
    """(K, N) share of its friction and spines that the worst part of a grip may lack."""
    holds = holds_of(subject.plan)
    contact = subject.plan.instants.contact
    bounds = spine_bounds(grips.model, grips.risk, holds)
    hands = _hands(subject, gripper, grips, holds, bounds, np.zeros(contact.shape))
    loaded = contact[..., None] & (hands.shear > _NO_SHEAR * subject.weight)
    return np.asarray(1 - np.where(loaded, hands.share(), 0.0).max(axis=-1))


def further_pull(subject: Subject, gripper: Gripper, grips: GripPlan) -> Array:
    """(K, N) further pull that grips hold [N], found by halving intervals; 0 of lifted limbs."""
    contact = subject.plan.instants.contact
    holds = holds_of(subject.plan)
    bounds = spine_bounds(grips.model, grips.risk, holds)

    def holds_at(pull: Array) -> Array:
        hands = _hands(subject, gripper, grips, holds, bounds, pull)
        slack = 1e-9 * subject.weight
        fine = (hands.shear <= hands.held + slack) & (hands.pressure >= -slack)
        return np.asarray(fine[..., 1:].all(axis=-1))

    low = np.zeros(contact.shape)
    high = np.where(holds_at(np.full(contact.shape, _FAR)), np.inf, _FAR)
    endless = np.isinf(high)
    high = np.where(endless, 0.0, high)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        fine = holds_at(middle)
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    return np.where(contact, np.where(endless, np.inf, low), 0.0)


def _pull_out(subject: Subject, grips: GripPlan, found: Array) -> Check:
    """The stored further pull that a grip holds (K, N) is what it does hold."""
    stored = grips.pull_margin
    both = np.isinf(found) & np.isinf(stored)
    off = np.abs(np.where(both, 0.0, found) - np.where(both, 0.0, stored)) / subject.weight
    least = np.where(subject.plan.instants.contact, found, np.inf).min()
    return judge_worst(
        "grip.pull_out", off, subject.at, margin=f"least further pull held {least:.1f} N"
    )


def _factors(
    subject: Subject, gripper: Gripper, grips: GripPlan, hands: Hands, spines: Array
) -> Check:
    """Stored safety factors are those of the stored grips."""
    plan = subject.plan
    forces, contact = plan.forces, plan.instants.contact[..., None]
    loaded: BoolArray = contact & (hands.shear > _NO_SHEAR * subject.weight)
    friction = np.where(loaded, hands.share(), 0.0).max(axis=(1, 2))
    use = [
        (np.abs(subject.torques + subject.link_torques) / plan.robot.max_torque).max(axis=(1, 2)),
        (np.abs(grips.wrist_torque) / gripper.wrist_max_torque).max(axis=(1, 2)),
    ]
    if gripper.max_force > 0:
        use.append((grips.instants.grip / gripper.max_force).max(axis=1))
    tight = np.asarray(np.max(use, axis=0))
    off = np.stack(
        [
            np.abs(1 / forces.safety_torque - tight),
            np.abs(1 / forces.safety_friction - friction),
            np.abs(forces.mu_critical - _critical(hands, spines, loaded)).max(axis=1),
        ],
        axis=1,
    )
    names = ("safety_torque", "safety_friction", "mu_critical")
    return judge_worst("safety.stored", off, lambda k, row: f"{subject.at(k)}, {names[row]}")


def _critical(hands: Hands, spines: Array, loaded: BoolArray) -> Array:
    """(K, N) friction coefficient at which a part slips, its spines holding as counted on."""
    own = np.stack([0 * spines, spines / 2, spines / 2], axis=-1)
    beyond = np.maximum(hands.shear - own, 0.0)
    ratio = np.where(beyond > 0, np.inf, 0.0)
    np.divide(beyond, hands.pressure, out=ratio, where=hands.pressure > 0)
    return np.asarray(np.where(loaded, ratio, 0.0).max(axis=-1))
