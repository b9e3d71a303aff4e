"""Checks of grips between the instants: shear, gripping force and wrists."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.grips import (
    PART_NAMES,
    GripForcesByPart,
    bound_spine_forces,
    build_holds,
    compute_part_forces,
    compute_wrist_axes,
)
from climbplan.climb.check.anew.kinematics import Limbs
from climbplan.climb.check.subject import Subject
from climbplan.climb.plan.grips import GripForces
from climbplan.robots.gripper import WRIST_JOINTS, Gripper
from climbplan.verification.check import Check, judge_worst

_SHEAR_TOLERANCE = 1e-6  # of the weight


def compute_wrist_moment(subject: Subject, normal: Array) -> Array | None:
    """Return the moment (T, N, 3) about the wrists' centres [N m]; None without grippers."""
    plan = subject.plan
    if plan.robot.gripper is None or plan.grips is None:
        return None
    lever_arm = -plan.robot.gripper.length * normal
    return plan.grips.trajectory.moment + np.cross(lever_arm, plan.grips.trajectory_force)


def check_grips_in_motion(
    subject: Subject,
    force: Array,
    limbs: Limbs,
    instant: IntArray,
    standing: BoolArray,
    describe_place: Callable[..., str],
) -> Iterator[Check]:
    """Yield the checks of grips at T samples.

    Args:
        subject: The plan under verification.
        force: (T, N, 3) contact forces under the joint commands [N].
        limbs: The limbs as they stand.
        instant: (T,) instants whose surfaces the toes are on.
        standing: (T, N) bool, limb is in contact.
        describe_place: Describes sample and limb.
    """
    plan = subject.plan
    gripper, grips = plan.robot.gripper, plan.grips
    if gripper is None or grips is None:
        return
    holds = build_holds(plan)
    region, normal = plan.instants.region[instant], plan.instants.normal[instant]
    bounds = bound_spine_forces(grips.model, grips.risk, holds)
    part_forces = compute_part_forces(
        force,
        grips.trajectory,
        normal,
        region,
        holds=holds,
        spines=bounds,
        span=gripper.finger_span,
    )
    weight = subject.weight
    yield _judge_shear(part_forces, standing, weight, describe_place)
    force_error = np.linalg.norm(force - grips.trajectory_force, axis=-1) / weight
    yield judge_worst("trajectory.contact_force", force_error, describe_place)
    yield _judge_gripping(gripper, grips.trajectory, standing, describe_place)
    moment = compute_wrist_moment(subject, normal)
    assert moment is not None
    link = limbs.compute_link_frame()
    angles = _solve_wrist_angles(link, -normal, holds.axis[region])
    torque = np.einsum("tnji,tni->tnj", compute_wrist_axes(link, angles), moment)
    yield from _judge_wrists(gripper, angles, torque, standing, describe_place)


def _judge_shear(
    part_forces: GripForcesByPart,
    standing: BoolArray,
    weight: float,
    describe_place: Callable[..., str],
) -> Check:
    """Check that palms press and that friction and spines carry the shear of each part."""
    is_standing = standing[..., None]
    excess = np.where(
        is_standing,
        np.maximum(part_forces.shear - part_forces.max_shear, -part_forces.pressure),
        -np.inf,
    )
    is_sheared = is_standing & (part_forces.shear > _SHEAR_TOLERANCE * weight)
    shear_ratio = np.where(is_sheared, part_forces.compute_shear_ratio(), 0.0)

    def describe_part(sample: int, limb: int, index: int) -> str:
        return f"{describe_place(sample, limb)} {PART_NAMES[index]}"

    margin = f"S_mu {1 / shear_ratio.max():.2f}" if shear_ratio.any() else "no shear"
    return judge_worst(
        "trajectory.grip_shear", excess / weight, describe_part, margin, used=shear_ratio
    )


def _judge_gripping(
    gripper: Gripper, grips: GripForces, standing: BoolArray, describe_place: Callable[..., str]
) -> Check:
    """Check that standing limbs grip within their force, and others do not grip."""
    grip_force = grips.grip
    idle_grip = np.where(standing, 0.0, np.abs(grips.packed_array).max(axis=-1))
    return judge_worst(
        "trajectory.grip_force",
        np.maximum(np.maximum(grip_force - gripper.max_force, -grip_force), idle_grip),
        describe_place,
        margin=f"at most {grip_force.max():.1f} N",
        used=grip_force / gripper.max_force if gripper.max_force > 0 else np.zeros_like(grip_force),
    )


def _judge_wrists(
    gripper: Gripper,
    angles: Array,
    torque: Array,
    standing: BoolArray,
    describe_place: Callable[..., str],
) -> Iterator[Check]:
    """Yield the checks of angles and torques (T, N, 3) of wrists."""
    is_standing = standing[..., None]

    def describe_joint(sample: int, limb: int, index: int) -> str:
        return f"{describe_place(sample, limb)} {WRIST_JOINTS[index]}"

    bound_violation = np.maximum(gripper.wrist_lower - angles, angles - gripper.wrist_upper)
    bound_violation = np.where(is_standing, bound_violation, -np.inf)
    half_range = (gripper.wrist_upper - gripper.wrist_lower) / 2
    margin = f"{np.rad2deg(-bound_violation.max()):.1f} deg"
    bound_ratio = np.where(is_standing, 1 + bound_violation / half_range, 0.0)
    yield judge_worst(
        "trajectory.wrist_bounds", bound_violation, describe_joint, margin, used=bound_ratio
    )
    torque_ratio = np.where(is_standing, np.abs(torque) / gripper.wrist_max_torque, 0.0)
    max_torque = np.where(is_standing, np.abs(torque), 0.0).max()
    yield judge_worst(
        "trajectory.wrist_torque",
        torque_ratio - 1.0,
        describe_joint,
        f"at most {max_torque:.2f} N m",
        used=torque_ratio,
    )


def _solve_wrist_angles(link: Array, approach: Array, axis: Array) -> Array:
    """Return wrist angles (..., 3) that hold a gripper square on its hold."""
    x, y, z = link[..., 0, :], link[..., 1, :], link[..., 2, :]
    sine = (approach * y).sum(axis=-1)
    first = np.arctan2(-(approach * z).sum(axis=-1), (approach * x).sum(axis=-1))
    second = np.arctan2(sine, np.sqrt(np.maximum(1 - sine**2, 0.0)))
    untwisted = np.stack([first, second, np.zeros_like(first)], axis=-1)
    tilted = compute_wrist_axes(link, untwisted)[..., 1, :]
    tilted_cross = np.cross(tilted, approach)
    third = np.arctan2((axis * tilted).sum(axis=-1), (axis * tilted_cross).sum(axis=-1))
    return np.stack([first, second, third - np.pi * np.round(third / np.pi)], axis=-1)
