"""Margins: what the plan keeps in hand beside its bounds, recomputed from the file alone.

A margin that is missed breaks nothing that the plan promises of its model: it is told, and the plan
is called fragile. Depth is where the command would put a free toe, exactly, not to first order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.soles import centre_of_pressure, lying
from climbplan.climb.check.anew.static_pose import Settled
from climbplan.climb.check.grips import friction_in_hand, further_pull
from climbplan.climb.check.subject import Subject
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.verification.check import Check, judge_worst, unjudged

WHOLE = 0.95  # part of a margin that counts as kept; the rest is rounding and arcs of limbs
_SMOOTH = 1e-9  # least friction coefficient divided by


def robust_checks(
    subject: Subject, settled: Settled, margins: MarginsSpec | None
) -> Iterator[Check]:
    """Pressure, friction and depth of toes in contact, and the stiffness that is left.

    Of grips the further pull that they hold, and the friction they may lack.
    margins: of the spec; None where it asks for none, which leaves nothing to say.
    """
    if margins is None:
        return
    plan = subject.plan
    weight = subject.weight * margins.factors(plan.instants.round)
    still = np.ones(len(weight))
    if plan.robot.gripper is not None and plan.grips is not None:
        gripper, grips = plan.robot.gripper, plan.grips
        closed = weight if gripper.max_force > 0 else 0 * weight
        pull = further_pull(subject, gripper, grips)
        yield _toes(subject, "robust.pull", pull, margins.pull * closed)
        spare = friction_in_hand(subject, gripper, grips)
        yield _toes(subject, "robust.slip", spare, margins.slip * still)
        return
    left = np.where(np.isfinite(settled.stiffness_left), settled.stiffness_left, -1.0)
    mu = np.maximum(plan.instants.mu, _SMOOTH) / plan.limits.safety_friction
    spare = subject.contact_force - subject.tangential_force / mu
    outward = plan.forces.toe_command - plan.instants.toes
    depth = -np.einsum("kni,kni->kn", outward, plan.instants.normal)
    held = np.maximum(plan.instants.mu * subject.contact_force, _SMOOTH)
    lacking = 1 - subject.tangential_force / held
    yield _toes(subject, "robust.pressure", subject.contact_force, margins.pressure * weight)
    yield _toes(subject, "robust.friction", spare, margins.friction * weight)
    yield _toes(subject, "robust.slip", lacking, margins.slip * still)
    yield _toes(subject, "robust.depth", depth, margins.depth * still)
    sole = plan.robot.sole
    if sole is not None:
        wrench = plan.forces.force, subject.held_moment
        centre = centre_of_pressure(lying(sole, plan.instants.normal), *wrench)
        half = np.array([sole.width, sole.length]) / 2
        inside = 1.0 - np.abs(centre / half).max(axis=-1)
        inside = np.where(np.isnan(inside), np.inf, inside)  # of a foot without pressure
        yield _toes(subject, "robust.sole", inside, margins.sole * still)
    yield _toes(
        subject, "robust.torque", 1 - subject.torque_use.max(axis=2), margins.torque * still
    )
    yield _told(
        judge_worst(
            "robust.stiffness",
            WHOLE * margins.stiffness - left,
            subject.at,
            margin=f"{100 * left.min():.0f} of {100 * margins.stiffness:.0f} % left",
        )
    )


# By check: the quantity that has the margin, its unit with the factor to it, and decimals
_WORDS = {
    "robust.pressure": ("normal force", 1.0, "N", 1),
    "robust.friction": ("normal-force reserve of the friction cone", 1.0, "N", 1),
    "robust.slip": ("loss of friction before it slides", 1e2, "%", 0),
    "robust.pull": ("pull-out reserve", 1.0, "N", 1),
    "robust.sole": ("centre of pressure inside the edge by", 1e2, "% of the half size", 0),
    "robust.torque": ("torque reserve", 1e2, "% of the limit", 0),
    "robust.depth": ("commanded penetration", 1e3, "mm", 1),
}


def _toes(subject: Subject, name: str, value: Array, asked: Array) -> Check:
    """A margin of toes in contact, by what they have (K, N) and are asked for (K,)."""
    contact = subject.plan.instants.contact
    missed = np.where(contact, WHOLE * asked[:, None] - value, -np.inf)
    k, limb = np.unravel_index(int(np.argmax(missed)), missed.shape)
    quantity, scale, unit, digits = _WORDS[name]
    least = f"{scale * value[k, limb]:.{digits}f} of {scale * asked[k]:.{digits}f} {unit}"
    words = f"{subject.limb(int(limb))}: {quantity} {least}"
    return _told(judge_worst(name, missed, subject.at, margin=words))


def _told(check: Check) -> Check:
    """A margin that is missed decides nothing; the plan is fragile for it."""
    if check.passed:
        return check
    place = check.worst_at.rpartition(", ")[0] if check.name != "robust.stiffness" else ""
    where = place or check.worst_at
    subject = "stiffness of the body: " if check.name == "robust.stiffness" else ""
    words = f"{where}: {subject}{check.margin}"
    return replace(unjudged(check, "a margin, kept where it can be"), fragile=words)
