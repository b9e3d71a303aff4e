"""Checks of robustness margins: what the plan keeps beyond its bounds.

A missed margin violates no bound of the plan. It is reported, and the plan is called fragile.
Penetration is where the command would put a free toe, exactly, not to first order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.soles import compute_pressure_centre, compute_sole_axes
from climbplan.climb.check.anew.static_pose import StaticEquilibrium
from climbplan.climb.check.grips import compute_friction_reserve, find_max_pull
from climbplan.climb.check.subject import Subject
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.verification.check import Check, judge_worst, mark_unjudged

KEPT_FRACTION = 0.95  # part of a margin that counts as kept; the rest is rounding and arcs of limbs
_MIN_MU = 1e-9  # least friction coefficient divided by


def check_margins(
    subject: Subject, equilibrium: StaticEquilibrium, margins: MarginsSpec | None
) -> Iterator[Check]:
    """Yield the checks of the spec's margins for toes in contact and for stiffness.

    For grips these are the pull that they hold in addition, and the friction that they may lose.

    Args:
        subject: The plan under verification.
        equilibrium: The static equilibria of its instants.
        margins: Margins of the spec; None gives no checks.
    """
    if margins is None:
        return
    plan = subject.plan
    weight = subject.weight * margins.factors(plan.instants.round)
    ones = np.ones(len(weight))
    if plan.robot.gripper is not None and plan.grips is not None:
        gripper, grips = plan.robot.gripper, plan.grips
        gripping_weight = weight if gripper.max_force > 0 else 0 * weight
        pull = find_max_pull(subject, gripper, grips)
        yield _check_toe_margin(subject, "robust.pull", pull, margins.pull * gripping_weight)
        friction_reserve = compute_friction_reserve(subject, gripper, grips)
        yield _check_toe_margin(subject, "robust.slip", friction_reserve, margins.slip * ones)
        return
    stiffness_ratio = np.where(
        np.isfinite(equilibrium.stiffness_ratio), equilibrium.stiffness_ratio, -1.0
    )
    mu = np.maximum(plan.instants.mu, _MIN_MU) / plan.limits.safety_friction
    friction_reserve = subject.contact_force - subject.tangential_force / mu
    toe_offset = plan.forces.toe_command - plan.instants.toes
    depth = -np.einsum("kni,kni->kn", toe_offset, plan.instants.normal)
    max_shear = np.maximum(plan.instants.mu * subject.contact_force, _MIN_MU)
    friction_loss = 1 - subject.tangential_force / max_shear
    yield _check_toe_margin(
        subject, "robust.normal_force", subject.contact_force, margins.normal_force * weight
    )
    yield _check_toe_margin(subject, "robust.friction", friction_reserve, margins.friction * weight)
    yield _check_toe_margin(subject, "robust.slip", friction_loss, margins.slip * ones)
    yield _check_toe_margin(subject, "robust.depth", depth, margins.depth * ones)
    sole = plan.robot.sole
    if sole is not None:
        wrench = plan.forces.force, subject.contact_moment
        centre = compute_pressure_centre(compute_sole_axes(sole, plan.instants.normal), *wrench)
        half = np.array([sole.width, sole.length]) / 2
        inside = 1.0 - np.abs(centre / half).max(axis=-1)
        inside = np.where(np.isnan(inside), np.inf, inside)  # of a foot without pressure
        yield _check_toe_margin(subject, "robust.sole", inside, margins.sole * ones)
    yield _check_toe_margin(
        subject, "robust.torque", 1 - subject.torque_ratio.max(axis=2), margins.torque * ones
    )
    yield _mark_fragile(
        judge_worst(
            "robust.stiffness",
            KEPT_FRACTION * margins.stiffness - stiffness_ratio,
            subject.describe_instant,
            margin=f"{100 * stiffness_ratio.min():.0f} % left, "
            f"margin {100 * margins.stiffness:.0f} %",
        )
    )


# By check: the quantity that has the margin, its unit with the factor to it, and decimals
_QUANTITIES = {
    "robust.normal_force": ("normal force", 1.0, "N", 1),
    "robust.friction": ("normal-force reserve of the friction cone", 1.0, "N", 1),
    "robust.slip": ("loss of friction before it slides", 1e2, "%", 0),
    "robust.pull": ("pull-out reserve", 1.0, "N", 1),
    "robust.sole": ("centre of pressure inside the edge by", 1e2, "% of the half size", 0),
    "robust.torque": ("torque reserve", 1e2, "% of the limit", 0),
    "robust.depth": ("commanded penetration", 1e3, "mm", 1),
}


def _check_toe_margin(subject: Subject, name: str, value: Array, required: Array) -> Check:
    """Check a margin of toes in contact: values (K, N) against requirements (K,)."""
    contact = subject.plan.instants.contact
    shortfall = np.where(contact, KEPT_FRACTION * required[:, None] - value, -np.inf)
    k, limb = np.unravel_index(int(np.argmax(shortfall)), shortfall.shape)
    quantity, scale, unit, digits = _QUANTITIES[name]
    number, margin = scale * float(value[k, limb]), scale * float(required[k])
    if name == "robust.depth" and number < 0:
        value_text = (
            f"commanded {-number:.1f} mm outside its surface, margin {margin:.1f} mm inside"
        )
    else:
        value_text = f"{quantity} {number:.{digits}f} {unit}, margin {margin:.{digits}f} {unit}"
    margin_text = f"{subject.name_limb(int(limb))}: {value_text}"
    return _mark_fragile(judge_worst(name, shortfall, subject.describe_instant, margin=margin_text))


def _mark_fragile(check: Check) -> Check:
    """Mark a missed margin as informational, with the plan as fragile."""
    if check.passed:
        return check
    place = check.worst_at.rpartition(", ")[0] if check.name != "robust.stiffness" else ""
    place_text = place or check.worst_at
    subject = "stiffness of the body: " if check.name == "robust.stiffness" else ""
    fragility_text = f"{place_text}: {subject}{check.margin}"
    return replace(mark_unjudged(check, "a margin, kept where it can be"), fragile=fragility_text)
