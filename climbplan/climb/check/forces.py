"""Checks of forces, torques and deflections at the instants (chapters 4.2 and 5.1.4).

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.kinematics import build_limbs
from climbplan.climb.check.friction_factor import compute_friction_factor, format_min_factor
from climbplan.climb.check.grips import check_grips
from climbplan.climb.check.soles import check_soles, split_pressure_shear
from climbplan.climb.check.subject import Subject
from climbplan.verification.check import Check, judge_worst


def check_forces(subject: Subject) -> Iterator[Check]:
    """Yield checks of equilibrium, friction, contact, torques, stiffness and stored factors."""
    yield _check_equilibrium(subject)
    if subject.plan.robot.gripper is None:
        yield from _check_contacts(subject)
        yield from check_soles(subject)
    else:
        yield _check_lifted(subject)
    yield from _check_torques(subject)
    yield from _check_stiffness(subject)
    if subject.plan.robot.gripper is None:
        yield _check_stored_factors(subject)
    yield from check_grips(subject)


def _check_equilibrium(subject: Subject) -> Check:
    """Check eqs. (4.15) and (4.16): forces and moments about the body origin."""
    force, load = subject.plan.forces.force, subject.load
    total = force.sum(axis=1) + load[:, :3]
    moment = np.cross(subject.arms, force).sum(axis=1) + load[:, 3:]
    moment = moment + subject.contact_moment.sum(axis=1)
    residual = np.stack([np.linalg.norm(total, axis=1), np.linalg.norm(moment, axis=1)], axis=1)
    row_names = ("forces", "moments")
    return judge_worst(
        "force.equilibrium",
        residual / subject.weight,
        lambda k, row: f"{subject.describe_instant(k)}, {row_names[row]}",
    )


def _check_contacts(subject: Subject) -> Iterator[Check]:
    """Check unilateral contact, the friction cone, and that lifted limbs bear no force."""
    plan = subject.plan
    contact, mu = plan.instants.contact, plan.instants.mu
    normal, tangent = subject.contact_force, subject.tangential_force
    min_normal_force = np.where(contact, normal, np.inf).min()
    corner_forces = plan.forces.corner_force
    describe_place: Callable[..., str] = subject.describe_instant
    if corner_forces is not None:  # each corner of a sole for itself
        normal, tangent = split_pressure_shear(corner_forces, plan.instants.normal)
        contact, mu, describe_place = contact[..., None], mu[..., None], subject.describe_corner
    yield judge_worst(
        "force.unilateral",
        np.where(contact, -normal, -np.inf) / subject.weight,
        describe_place,
        margin=f"least normal force {min_normal_force:.1f} N",
    )

    required = plan.limits.safety_friction
    excess = np.where(contact, tangent - mu * normal / required, -np.inf) / subject.weight
    factor = compute_friction_factor("force.friction", tangent, mu * normal, subject.weight)
    factor = np.where(contact, factor, np.inf)
    yield judge_worst(
        "force.friction",
        excess,
        describe_place,
        margin=format_min_factor(factor),
        used=required / np.maximum(factor, 1e-300),
    )

    yield _check_lifted(subject)


def _check_lifted(subject: Subject) -> Check:
    """Check that lifted limbs bear no force."""
    plan = subject.plan
    size = np.linalg.norm(plan.forces.force, axis=-1)
    on_lifted = np.where(plan.instants.contact, 0.0, size)
    return judge_worst(
        "force.without_contact", on_lifted / subject.weight, subject.describe_instant
    )


def _check_torques(subject: Subject) -> Iterator[Check]:
    """Check tau = J^T f, and torques with the links' own weight against the limits."""
    plan = subject.plan
    torques, link_torques = subject.torques, subject.link_torques
    stored = plan.forces.link_torques
    error = np.abs(torques - plan.forces.joint_torques)
    error = np.maximum(error, np.abs(link_torques - (0.0 if stored is None else stored)))
    yield judge_worst("torque.from_forces", error, subject.describe_instant)
    torque_ratio = subject.torque_ratio
    yield judge_worst(
        "torque.limit",
        torque_ratio - 1 / plan.limits.safety_torque,
        subject.describe_instant,
        margin=f"S_tau {_invert_ratio(torque_ratio.max()):.2f}",
        used=torque_ratio * plan.limits.safety_torque,
    )


def _check_stiffness(subject: Subject) -> Iterator[Check]:
    """Check eq. (4.14) with the limb compliance instead of its inverse, and the commands.

    Commands differ from the joint angles by what moves the toes by the wall deflection.
    """
    plan = subject.plan
    robot, instants, forces = plan.robot, plan.instants, plan.forces
    # J k^-1 J^T f is J applied to the joints' own deflections under tau = J^T f.
    joint_deflection = subject.torques / robot.joint_stiffness
    jacobian = subject.contact_limbs.jacobian()
    structural_deflection = np.einsum("knij,knj->kni", jacobian, joint_deflection)
    structural_deflection = structural_deflection / (1 - robot.structural_compliance_share)
    # [I P^T] d_com moves the toes with the body: translation and rotation x arm.
    body_motion = forces.com_deflection[:, None, :3] + np.cross(
        forces.com_deflection[:, None, 3:], subject.arms
    )
    error = np.linalg.norm(structural_deflection + body_motion - forces.wall_deflection, axis=-1)
    yield judge_worst(
        "stiffness.force_deflection",
        np.where(instants.contact, error, 0.0),
        subject.describe_instant,
    )
    commanded_deflection = instants.joint_angles - forces.joint_command
    toe_deflection = np.einsum("knij,knj->kni", jacobian, commanded_deflection)
    error = np.linalg.norm(toe_deflection - forces.wall_deflection, axis=-1)
    yield judge_worst("stiffness.joint_command", error, subject.describe_instant)
    commanded = build_limbs(robot, instants.com, subject.axes, forces.joint_command)
    error = np.linalg.norm(forces.toe_command - commanded.toe, axis=-1)
    yield judge_worst("stiffness.toe_command", error, subject.describe_instant)


def _check_stored_factors(subject: Subject) -> Check:
    """Check stored safety factors as inverse ratios, so that infinite factors compare as zero."""
    plan = subject.plan
    forces, instants = plan.forces, plan.instants
    normal, tangent = subject.contact_force, subject.tangential_force
    critical_mu = np.where(instants.contact, _compute_ratio(tangent, normal), 0.0)
    if forces.corner_force is not None:  # of the corner that slips first
        corner_mu = _compute_ratio(
            *reversed(split_pressure_shear(forces.corner_force, instants.normal))
        )
        critical_mu = np.where(instants.contact, corner_mu.max(axis=-1), 0.0)
    motor_torque = subject.torques + subject.link_torques
    torque = (np.abs(motor_torque) / plan.robot.max_torque).max(axis=(1, 2))
    friction = _compute_ratio(critical_mu, instants.mu).max(axis=1)
    error = np.stack(
        [
            np.abs(1 / forces.safety_torque - torque),
            np.abs(1 / forces.safety_friction - friction),
            np.abs(forces.mu_critical - critical_mu).max(axis=1),
        ],
        axis=1,
    )
    names = ("safety_torque", "safety_friction", "mu_critical")
    return judge_worst(
        "safety.stored", error, lambda k, row: f"{subject.describe_instant(k)}, {names[row]}"
    )


def _compute_ratio(value: Array, allowed: Array) -> Array:
    """Return value / allowed; 0 if the value is 0, infinite if nothing is allowed."""
    ratio = np.full(np.broadcast(value, allowed).shape, np.inf)
    np.divide(value, allowed, out=ratio, where=allowed > 0)
    return np.where(value == 0, 0.0, ratio)


def _invert_ratio(ratio: float) -> float:
    """Return the inverse of a ratio, infinite for 0."""
    return float("inf") if ratio == 0 else 1.0 / float(ratio)
