"""Checks of grips: cones, gripping force, moments, wrists, pull-out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.grips import (
    PART_NAMES,
    GripForcesByPart,
    Holds,
    bound_spine_forces,
    build_holds,
    compute_gripper_frames,
    compute_part_forces,
    compute_wrist_axes,
)
from climbplan.climb.check.self_collision import measure_segment_distances
from climbplan.climb.check.subject import Subject
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.grips import GripPlan
from climbplan.robots.gripper import WRIST_JOINTS, Gripper
from climbplan.terrain.surfaces import Region
from climbplan.verification.check import Check, check_faults, judge_worst

_REPORTED_CLEARANCE = 0.02  # [m] room up to which it is measured


def check_gripper_clearance(subject: Subject, gripper: Gripper, holds: Holds) -> Check:
    """Check the clearance between grippers of every two standing limbs at every instant.

    Each gripper is a T with the thickness of a limb: from the wrist to the grip's centre, and from
    finger to finger.
    """
    plan = subject.plan
    instants, names = plan.instants, plan.robot.limb_names
    wrists = instants.toes
    palms = wrists - gripper.length * instants.normal
    fingers = gripper.finger_span / 2 * holds.axis[instants.region]
    bars = (
        np.stack([wrists, palms], axis=2),
        np.stack([palms - fingers, palms + fingers], axis=2),
    )  # (K, N, 2, 3)
    thickness = 2 * plan.robot.limb_radius
    pairs = list(itertools.combinations(range(len(names)), 2))
    clearance = np.full((instants.count, len(pairs)), _REPORTED_CLEARANCE)
    for column, (first, second) in enumerate(pairs):
        both_standing = np.flatnonzero(instants.contact[:, first] & instants.contact[:, second])
        for a, b in itertools.product(bars, bars):
            bar_clearance = (
                measure_segment_distances(
                    a[both_standing, first],
                    b[both_standing, second],
                    thickness + _REPORTED_CLEARANCE,
                )
                - thickness
            )
            clearance[both_standing, column] = np.minimum(
                clearance[both_standing, column], bar_clearance
            )

    def describe_place(k: int, column: int) -> str:
        first, second = pairs[column]
        return f"{subject.describe_instant(k)}, {names[first]} and {names[second]}"

    min_clearance = float(clearance.min())
    qualifier = "at least " if min_clearance >= _REPORTED_CLEARANCE else ""
    return judge_worst(
        "grip.apart",
        -clearance,
        describe_place,
        f"{qualifier}{1e3 * min_clearance:.1f} mm between grippers",
    )


_SHEAR_TOLERANCE = 1e-6  # of the weight: less is rounding of forces that are zero
_NUM_BISECTIONS = 60
_MAX_PULL = 1e6  # [N] a pull that counts as any


def check_gripper_data(plan: ClimbPlan) -> Check:
    """Check the data of grippers, holds and spine model; passes without grippers."""
    faults: list[str] = []
    gripper, grips = plan.robot.gripper, plan.grips
    for surface in plan.terrain.surfaces:
        if isinstance(surface, Region) and surface.hold is not None:
            hold = surface.hold
            is_unit = abs(np.linalg.norm(hold.axis) - 1) < 1e-6
            if not (is_unit and abs(hold.axis @ surface.normal) < 1e-6):
                faults.append(f"fingers' axis on {surface.name!r} is no direction in it")
            if not -np.pi / 2 - 1e-9 <= hold.undercut < np.pi / 2:
                faults.append(f"undercut of {surface.name!r} is not within -90 to 90 deg")
    if gripper is not None and grips is not None:
        positive_values = {
            "length": gripper.length,
            "finger_span": gripper.finger_span,
            "wrist_max_torque": gripper.wrist_max_torque.min(),
            "wrist_upper - wrist_lower": (gripper.wrist_upper - gripper.wrist_lower).min(),
            "model noise": grips.model.noise,
            "model length": grips.model.length,
            "model scale": grips.model.scale.min(),
        }
        faults += [
            f"{name} is not above zero" for name, value in positive_values.items() if not value > 0
        ]
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
    return check_faults("grip.data", faults)


def check_grips(subject: Subject) -> Iterator[Check]:
    """Yield all checks of a plan with grippers."""
    plan = subject.plan
    gripper, grips = plan.robot.gripper, plan.grips
    if gripper is None or grips is None:
        return
    holds = build_holds(plan)
    bounds = bound_spine_forces(grips.model, grips.risk, holds)
    spine_error = np.abs(bounds - grips.spines)
    yield judge_worst("grip.spines", spine_error, lambda r: f"on {plan.terrain.surfaces[r].name!r}")
    part_forces = _compute_part_forces(
        subject, gripper, grips, holds, bounds, np.zeros(plan.instants.contact.shape)
    )
    yield from _check_cones(subject, part_forces)
    yield from _check_gripping_force(subject, gripper, grips, part_forces)
    yield from _check_wrists(subject, gripper, grips, holds)
    yield check_gripper_clearance(subject, gripper, holds)
    yield _check_pull_out(subject, grips, find_max_pull(subject, gripper, grips))
    yield _check_stored_factors(subject, gripper, grips, part_forces, bounds[plan.instants.region])


def _check_cones(subject: Subject, part_forces: GripForcesByPart) -> Iterator[Check]:
    """Check that palm and fingers press, with shear within friction and spines over S_mu."""
    contact = subject.plan.instants.contact[..., None]

    def describe_place(k: int, limb: int, part_index: int) -> str:
        return f"{subject.describe_instant(k)}, {subject.name_limb(limb)} {PART_NAMES[part_index]}"

    pull = np.where(contact, -part_forces.pressure, -np.inf) / subject.weight
    yield judge_worst("grip.unilateral", pull, describe_place)
    required = subject.plan.limits.safety_friction
    is_sheared = contact & (part_forces.shear > _SHEAR_TOLERANCE * subject.weight)
    excess = (
        np.where(contact, part_forces.shear - part_forces.max_shear / required, -np.inf)
        / subject.weight
    )
    shear_ratio = np.where(is_sheared, part_forces.compute_shear_ratio(), 0.0)
    margin = f"S_mu {1 / shear_ratio.max():.2f}" if shear_ratio.any() else "no shear"
    yield judge_worst("grip.shear", excess, describe_place, margin, used=shear_ratio * required)


def _check_gripping_force(
    subject: Subject, gripper: Gripper, grips: GripPlan, part_forces: GripForcesByPart
) -> Iterator[Check]:
    """Check gripping force against its limit over S_tau, and moments that fingers cannot carry."""
    plan = subject.plan
    force, contact = grips.instants.grip, plan.instants.contact
    limit = gripper.max_force / plan.limits.safety_torque
    excess = np.maximum(force - limit, -force)
    yield judge_worst(
        "grip.force",
        excess,
        subject.describe_instant,
        margin=f"at most {force.max():.1f} of {gripper.max_force:.4g} N",
        used=force / limit if limit > 0 else np.zeros_like(force),
    )
    # Without contact nothing is left at all
    packed = grips.instants.packed_array
    residual_grip = np.where(contact, 0.0, np.abs(packed).max(axis=-1))
    moment_norm = np.linalg.norm(grips.instants.moment, axis=-1)
    yield judge_worst(
        "grip.moment",
        np.maximum(part_forces.axial_moment, residual_grip),
        subject.describe_instant,
        margin=f"moments up to {moment_norm.max():.2f} N m",
    )


def _check_wrists(
    subject: Subject, gripper: Gripper, grips: GripPlan, holds: Holds
) -> Iterator[Check]:
    """Check that wrists hold the grippers square on their holds, within bounds and torques."""
    plan = subject.plan
    link = subject.limbs.compute_link_frame()
    frames = compute_gripper_frames(gripper, link, grips.wrist_angles)
    normal, axis = plan.instants.normal, holds.axis[plan.instants.region]
    approach_error = np.linalg.norm(frames[..., 0, :] + normal, axis=-1)
    closing = frames[..., 1, :]
    # Two fingers may be the other way round.
    closing_error = np.minimum(
        np.linalg.norm(closing - axis, axis=-1), np.linalg.norm(closing + axis, axis=-1)
    )
    yield judge_worst(
        "wrist.alignment", np.maximum(approach_error, closing_error), subject.describe_instant
    )

    def describe_place(k: int, limb: int, joint: int) -> str:
        return f"{subject.describe_instant(k)}, {subject.name_limb(limb)} {WRIST_JOINTS[joint]}"

    angles = grips.wrist_angles
    bound_violation = np.maximum(gripper.wrist_lower - angles, angles - gripper.wrist_upper)
    half_range = (gripper.wrist_upper - gripper.wrist_lower) / 2
    margin = f"{np.rad2deg(-bound_violation.max()):.1f} deg"
    yield judge_worst(
        "wrist.bounds",
        bound_violation,
        describe_place,
        margin,
        used=1 + bound_violation / half_range,
    )

    torque = np.einsum("knji,kni->knj", compute_wrist_axes(link, angles), subject.wrist_moment)
    torque = np.where(plan.instants.contact[..., None], torque, 0.0)
    yield judge_worst("wrist.from_forces", np.abs(torque - grips.wrist_torque), describe_place)
    torque_ratio = np.abs(torque) / gripper.wrist_max_torque
    required = plan.limits.safety_torque
    yield judge_worst(
        "wrist.torque",
        torque_ratio - 1 / required,
        describe_place,
        margin=f"at most {np.abs(torque).max():.2f} N m",
        used=torque_ratio * required,
    )


def _compute_part_forces(
    subject: Subject, gripper: Gripper, grips: GripPlan, holds: Holds, bounds: Array, pull: Array
) -> GripForcesByPart:
    """Return forces on palms and fingers at the instants, with an additional pull (K, N) [N]."""
    plan, instants = subject.plan, subject.plan.instants
    return compute_part_forces(
        plan.forces.force - pull[..., None] * instants.normal,
        grips.instants,
        instants.normal,
        instants.region,
        holds=holds,
        spines=bounds,
        span=gripper.finger_span,
    )


def compute_friction_reserve(subject: Subject, gripper: Gripper, grips: GripPlan) -> Array:
    """Return the fraction (K, N) of friction and spines that the worst part of a grip may lose."""
    holds = build_holds(subject.plan)
    contact = subject.plan.instants.contact
    bounds = bound_spine_forces(grips.model, grips.risk, holds)
    part_forces = _compute_part_forces(
        subject, gripper, grips, holds, bounds, np.zeros(contact.shape)
    )
    is_sheared = contact[..., None] & (part_forces.shear > _SHEAR_TOLERANCE * subject.weight)
    return np.asarray(1 - np.where(is_sheared, part_forces.compute_shear_ratio(), 0.0).max(axis=-1))


def find_max_pull(subject: Subject, gripper: Gripper, grips: GripPlan) -> Array:
    """Return the additional pull (K, N) that grips hold [N], by bisection; 0 for lifted limbs."""
    contact = subject.plan.instants.contact
    holds = build_holds(subject.plan)
    bounds = bound_spine_forces(grips.model, grips.risk, holds)

    def is_held(pull: Array) -> Array:
        part_forces = _compute_part_forces(subject, gripper, grips, holds, bounds, pull)
        slack = 1e-9 * subject.weight
        is_inside = (part_forces.shear <= part_forces.max_shear + slack) & (
            part_forces.pressure >= -slack
        )
        return np.asarray(is_inside[..., 1:].all(axis=-1))

    low = np.zeros(contact.shape)
    high = np.where(is_held(np.full(contact.shape, _MAX_PULL)), np.inf, _MAX_PULL)
    is_unbounded = np.isinf(high)
    high = np.where(is_unbounded, 0.0, high)
    for _ in range(_NUM_BISECTIONS):
        middle = (low + high) / 2
        is_feasible = is_held(middle)
        low, high = np.where(is_feasible, middle, low), np.where(is_feasible, high, middle)
    return np.where(contact, np.where(is_unbounded, np.inf, low), 0.0)


def _check_pull_out(subject: Subject, grips: GripPlan, max_pull: Array) -> Check:
    """Check the stored pull-out margin against the pull (K, N) that grips hold."""
    stored = grips.pull_margin
    both_infinite = np.isinf(max_pull) & np.isinf(stored)
    error = (
        np.abs(np.where(both_infinite, 0.0, max_pull) - np.where(both_infinite, 0.0, stored))
        / subject.weight
    )
    min_pull = np.where(subject.plan.instants.contact, max_pull, np.inf).min()
    return judge_worst(
        "grip.pull_out",
        error,
        subject.describe_instant,
        margin=f"least further pull held {min_pull:.1f} N",
    )


def _check_stored_factors(
    subject: Subject,
    gripper: Gripper,
    grips: GripPlan,
    part_forces: GripForcesByPart,
    spines: Array,
) -> Check:
    """Check that stored safety factors are those of the stored grips."""
    plan = subject.plan
    forces, contact = plan.forces, plan.instants.contact[..., None]
    is_sheared: BoolArray = contact & (part_forces.shear > _SHEAR_TOLERANCE * subject.weight)
    friction = np.where(is_sheared, part_forces.compute_shear_ratio(), 0.0).max(axis=(1, 2))
    load_ratios = [
        (np.abs(subject.torques + subject.link_torques) / plan.robot.max_torque).max(axis=(1, 2)),
        (np.abs(grips.wrist_torque) / gripper.wrist_max_torque).max(axis=(1, 2)),
    ]
    if gripper.max_force > 0:
        load_ratios.append((grips.instants.grip / gripper.max_force).max(axis=1))
    max_ratio = np.asarray(np.max(load_ratios, axis=0))
    error = np.stack(
        [
            np.abs(1 / forces.safety_torque - max_ratio),
            np.abs(1 / forces.safety_friction - friction),
            np.abs(forces.mu_critical - _compute_critical_mu(part_forces, spines, is_sheared)).max(
                axis=1
            ),
        ],
        axis=1,
    )
    names = ("safety_torque", "safety_friction", "mu_critical")
    return judge_worst(
        "safety.stored", error, lambda k, row: f"{subject.describe_instant(k)}, {names[row]}"
    )


def _compute_critical_mu(
    part_forces: GripForcesByPart, spines: Array, is_sheared: BoolArray
) -> Array:
    """Return the friction coefficient (K, N) at which a part slips, with spines at their bound."""
    spine_parts = np.stack([0 * spines, spines / 2, spines / 2], axis=-1)
    shear_excess = np.maximum(part_forces.shear - spine_parts, 0.0)
    ratio = np.where(shear_excess > 0, np.inf, 0.0)
    np.divide(shear_excess, part_forces.pressure, out=ratio, where=part_forces.pressure > 0)
    return np.asarray(np.where(is_sheared, ratio, 0.0).max(axis=-1))
