"""What the joint commands of the motion press with: body on its path, no slip, no overload."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.kinematics import body_axes, limbs_at
from climbplan.climb.check.anew.weights import link_torques
from climbplan.climb.check.friction_factor import friction_factor, least_factor
from climbplan.climb.check.grip_motion import motion_grips, wrist_moment_on_the_way
from climbplan.climb.check.motion_forces import motion_forces
from climbplan.climb.check.motion_state import Motion, angles_of, instants_of, load_of
from climbplan.climb.check.soles import sole_motion_checks
from climbplan.robots.joint_units import format_largest_torques
from climbplan.verification.check import Check, judge_worst


def pressing_checks(motion: Motion) -> Iterator[Check]:
    """The commands hold the body on its path, and no limb slips or is overloaded on the way."""
    plan = motion.subject.plan
    robot, trajectory = plan.robot, plan.trajectory
    k = instants_of(motion)
    normal, mu = plan.instants.normal[k], plan.instants.mu[k]
    found = motion_forces(
        robot,
        trajectory.com,
        body_axes(trajectory.rpy),
        motion.standing,
        trajectory.joint_command,
        ~motion.lifted,
        load_of(motion),
        wrist_moment_on_the_way(motion.subject, normal),
        motion.arm,
        motion.soles is not None,
    )
    off = _lengths(found.deflection)
    yield judge_worst(
        "trajectory.command",
        np.where(np.isnan(off), np.inf, off),
        lambda sample, row: f"{motion.at(sample)}, {('shifted', 'turned')[row]}",
    )

    if motion.soles is not None:
        yield from sole_motion_checks(motion, found, mu)
    elif robot.gripper is None:
        yield _friction(motion, found.force, normal, mu)
    else:
        limbs = limbs_at(robot, trajectory.com, body_axes(trajectory.rpy), motion.standing.angles)
        yield from motion_grips(motion.subject, found.force, limbs, k, ~motion.lifted, motion.at)
    held = found.torque + link_torques(robot, body_axes(trajectory.rpy), angles_of(motion))
    use = np.abs(held) / robot.max_torque
    most = f"at most {format_largest_torques(robot, held)}"
    yield judge_worst("trajectory.torque", use - 1.0, motion.at, margin=most, used=use)


def _friction(motion: Motion, force: Array, normal: Array, mu: Array) -> Check:
    """Forces (T, N, 3) within their friction cones."""
    pressure = np.einsum("tni,tni->tn", force, normal)
    shear = np.linalg.norm(force - pressure[..., None] * normal, axis=-1)
    factor = friction_factor("trajectory.friction", shear, mu * pressure, motion.subject.weight)
    factor = np.where(motion.lifted, np.inf, factor)
    excess = np.where(motion.lifted, -np.inf, shear - mu * pressure) / motion.subject.weight
    return judge_worst(
        "trajectory.friction",
        excess,
        motion.at,
        margin=least_factor(factor),
        used=1 / np.maximum(factor, 1e-300),
    )


def _lengths(deflection: Array) -> Array:
    """(T, 2) shift [m] and turn [rad] of body deflections (T, 6)."""
    parts = (deflection[:, :3], deflection[:, 3:])
    return np.stack([np.linalg.norm(part, axis=1) for part in parts], axis=1)
