"""Checks of forces under the motion's commands: body on its path, no slip, no overload."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.feet import compute_contact_arm, move_toes_to_contacts
from climbplan.climb.check.anew.kinematics import build_limbs, compute_body_axes
from climbplan.climb.check.anew.weights import compute_link_torques
from climbplan.climb.check.friction_factor import compute_friction_factor, format_min_factor
from climbplan.climb.check.grip_motion import check_grips_in_motion, compute_wrist_moment
from climbplan.climb.check.motion_forces import compute_motion_forces
from climbplan.climb.check.motion_state import (
    MotionState,
    compute_load,
    compute_motion_inertia,
    select_angles,
    select_instants,
)
from climbplan.climb.check.soles import check_soles_in_motion
from climbplan.climb.check.spec import states_pace
from climbplan.robots.joint_units import format_largest_torques
from climbplan.verification.check import Check, judge, judge_worst


def check_pressing(motion: MotionState) -> Iterator[Check]:
    """Yield checks that commands hold the body on its path, and that no limb slips or is
    overloaded.
    """
    plan = motion.subject.plan
    robot, trajectory = plan.robot, plan.trajectory
    inertia = compute_motion_inertia(motion)
    load = compute_load(motion) + inertia.wrench
    k = select_instants(motion)
    normal, mu = plan.instants.normal[k], plan.instants.mu[k]
    motion_forces = compute_motion_forces(
        robot,
        trajectory.com,
        compute_body_axes(trajectory.rpy),
        standing=motion.standing,
        command=trajectory.joint_command,
        contact=~motion.lifted,
        load=load,
        moment=compute_wrist_moment(motion.subject, normal),
        arm=motion.arm,
        is_flat=motion.soles is not None,
    )
    deflection = _measure_deflections(motion_forces.deflection)
    yield judge_worst(
        "trajectory.command",
        np.where(np.isnan(deflection), np.inf, deflection),
        lambda sample, row: f"{motion.describe_sample(sample)}, {('shifted', 'turned')[row]}",
    )

    if motion.soles is not None:
        yield from check_soles_in_motion(motion, motion_forces, mu)
    elif robot.gripper is None:
        yield _check_friction(motion, motion_forces.force, normal, mu)
    else:
        limbs = build_limbs(
            robot, trajectory.com, compute_body_axes(trajectory.rpy), motion.standing.angles
        )
        yield from check_grips_in_motion(
            motion.subject, motion_forces.force, limbs, k, ~motion.lifted, motion.describe_sample
        )
    link_torque = inertia.torque + compute_link_torques(
        robot, compute_body_axes(trajectory.rpy), select_angles(motion)
    )
    motor_torque = motion_forces.torque + link_torque
    torque_ratio = np.abs(motor_torque) / robot.max_torque
    max_torque = f"at most {format_largest_torques(robot, motor_torque)}"
    yield judge_worst(
        "trajectory.torque",
        torque_ratio - 1.0,
        motion.describe_sample,
        margin=max_torque,
        used=torque_ratio,
    )
    if trajectory.is_paced or states_pace(plan):
        yield _check_dynamics(motion, normal, load, link_torque)


def _check_dynamics(motion: MotionState, normal: Array, load: Array, link_torque: Array) -> Check:
    """Check that stored forces and torques move the links, by Newton's and Euler's equations.

    Args:
        motion: The motion.
        normal: (T, N, 3) of surfaces below toes.
        load: (T, 6) weight, external and inertial load about the body's origin [N, N m].
        link_torque: (T, N, J) of the links' weight and inertia [N m].
    """
    plan = motion.subject.plan
    robot, trajectory = plan.robot, plan.trajectory
    if trajectory.force is None or trajectory.torque is None:
        return judge(
            "trajectory.dynamics", np.inf, "no forces and torques, which the pace asks for"
        )
    limbs = build_limbs(
        robot, trajectory.com, compute_body_axes(trajectory.rpy), select_angles(motion)
    )
    arm = compute_contact_arm(robot, normal)
    force = np.where(motion.lifted[..., None], 0.0, trajectory.force)
    arms = limbs.toe + arm - trajectory.com[:, None]
    wrench = load + np.concatenate([force.sum(axis=1), np.cross(arms, force).sum(axis=1)], axis=1)
    torque = np.einsum("tnij,tni->tnj", move_toes_to_contacts(limbs, arm).jacobian(), force)
    if trajectory.moment is not None:
        moment = np.where(motion.lifted[..., None], 0.0, trajectory.moment)
        wrench[:, 3:] += moment.sum(axis=1)
        torque += (limbs.compute_angular_jacobian() @ moment[..., None])[..., 0]
    unbalanced = np.abs(wrench).max(axis=1) / motion.subject.weight
    torque_error = np.abs(trajectory.torque - torque - link_torque) / robot.max_torque
    error = np.maximum(unbalanced, torque_error.max(axis=(1, 2)))
    duration = float(trajectory.time[-1] - trajectory.time[0])
    return judge_worst(
        "trajectory.dynamics", error, motion.describe_sample, margin=f"{duration:.3g} s of motion"
    )


def _check_friction(motion: MotionState, force: Array, normal: Array, mu: Array) -> Check:
    """Check that forces (T, N, 3) are within their friction cones."""
    pressure = np.einsum("tni,tni->tn", force, normal)
    shear = np.linalg.norm(force - pressure[..., None] * normal, axis=-1)
    friction_factor = compute_friction_factor(
        "trajectory.friction", shear, mu * pressure, motion.subject.weight
    )
    friction_factor = np.where(motion.lifted, np.inf, friction_factor)
    excess = np.where(motion.lifted, -np.inf, shear - mu * pressure) / motion.subject.weight
    return judge_worst(
        "trajectory.friction",
        excess,
        motion.describe_sample,
        margin=format_min_factor(friction_factor),
        used=1 / np.maximum(friction_factor, 1e-300),
    )


def _measure_deflections(deflection: Array) -> Array:
    """Return shift [m] and rotation [rad] (T, 2) of body deflections (T, 6)."""
    components = (deflection[:, :3], deflection[:, 3:])
    return np.stack([np.linalg.norm(component, axis=1) for component in components], axis=1)
