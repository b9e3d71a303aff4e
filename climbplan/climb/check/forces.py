"""Forces, torques and deflections at the instants (chapters 4.2 and 5.1.4)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.kinematics import limbs_at
from climbplan.climb.check.friction_factor import friction_factor, least_factor
from climbplan.climb.check.grips import grip_checks
from climbplan.climb.check.soles import parted, sole_checks
from climbplan.climb.check.subject import Subject
from climbplan.verification.check import Check, judge_worst


def force_checks(subject: Subject) -> Iterator[Check]:
    """Equilibrium, friction, unilateral contact, torques, stiffness, stored safety factors."""
    yield _equilibrium(subject)
    if subject.plan.robot.gripper is None:
        yield from _contacts(subject)
        yield from sole_checks(subject)
    else:
        yield _lifted(subject)
    yield from _torques(subject)
    yield from _stiffness(subject)
    if subject.plan.robot.gripper is None:
        yield _stored_factors(subject)
    yield from grip_checks(subject)


def _equilibrium(subject: Subject) -> Check:
    """Eqs. (4.15) and (4.16): forces and moments about the body origin."""
    force, load = subject.plan.forces.force, subject.load
    total = force.sum(axis=1) + load[:, :3]
    moment = np.cross(subject.arms, force).sum(axis=1) + load[:, 3:]
    moment = moment + subject.held_moment.sum(axis=1)
    residual = np.stack([np.linalg.norm(total, axis=1), np.linalg.norm(moment, axis=1)], axis=1)
    what = ("forces", "moments")
    return judge_worst(
        "force.equilibrium",
        residual / subject.weight,
        lambda k, row: f"{subject.at(k)}, {what[row]}",
    )


def _contacts(subject: Subject) -> Iterator[Check]:
    """Unilateral contact and the friction cone; nothing on lifted limbs."""
    plan = subject.plan
    contact, mu = plan.instants.contact, plan.instants.mu
    normal, tangent = subject.contact_force, subject.tangential_force
    least = np.where(contact, normal, np.inf).min()
    pushes = plan.forces.corner_force
    at: Callable[..., str] = subject.at
    if pushes is not None:  # each corner of a sole for itself
        normal, tangent = parted(pushes, plan.instants.normal)
        contact, mu, at = contact[..., None], mu[..., None], subject.at_corner
    yield judge_worst(
        "force.unilateral",
        np.where(contact, -normal, -np.inf) / subject.weight,
        at,
        margin=f"least normal force {least:.1f} N",
    )

    asked = plan.limits.safety_friction
    excess = np.where(contact, tangent - mu * normal / asked, -np.inf) / subject.weight
    factor = friction_factor("force.friction", tangent, mu * normal, subject.weight)
    factor = np.where(contact, factor, np.inf)
    yield judge_worst(
        "force.friction",
        excess,
        at,
        margin=least_factor(factor),
        used=asked / np.maximum(factor, 1e-300),
    )

    yield _lifted(subject)


def _lifted(subject: Subject) -> Check:
    """Nothing on lifted limbs."""
    plan = subject.plan
    size = np.linalg.norm(plan.forces.force, axis=-1)
    on_lifted = np.where(plan.instants.contact, 0.0, size)
    return judge_worst("force.lifted_unloaded", on_lifted / subject.weight, subject.at)


def _torques(subject: Subject) -> Iterator[Check]:
    """tau = J^T f, and with the links' own weight within the limits."""
    plan = subject.plan
    torques, own = subject.torques, subject.link_torques
    stored = plan.forces.link_torques
    off = np.abs(torques - plan.forces.joint_torques)
    off = np.maximum(off, np.abs(own - (0.0 if stored is None else stored)))
    yield judge_worst("torque.from_angles", off, subject.at)
    use = subject.torque_use
    yield judge_worst(
        "torque.limit",
        use - 1 / plan.limits.safety_torque,
        subject.at,
        margin=f"S_tau {_inverse(use.max()):.2f}",
        used=use * plan.limits.safety_torque,
    )


def _stiffness(subject: Subject) -> Iterator[Check]:
    """Eq. (4.14) with the limb compliance instead of its inverse, and the commands.

    Joints are commanded beyond their angles by what would move the toes by the wall deflection.
    """
    plan = subject.plan
    robot, instants, forces = plan.robot, plan.instants, plan.forces
    # J k^-1 J^T f is J applied to the joints' own deflections under tau = J^T f.
    bending = subject.torques / robot.joint_stiffness
    jacobian = subject.pressed.jacobian()
    given = np.einsum("knij,knj->kni", jacobian, bending)
    given = given / (1 - robot.structural_compliance_share)
    # [I P^T] d_com moves the toes with the body: translation and rotation x arm.
    carried = forces.com_deflection[:, None, :3] + np.cross(
        forces.com_deflection[:, None, 3:], subject.arms
    )
    miss = np.linalg.norm(given + carried - forces.wall_deflection, axis=-1)
    yield judge_worst("stiffness.relation", np.where(instants.contact, miss, 0.0), subject.at)
    turned = instants.joint_angles - forces.joint_command
    imposed = np.einsum("knij,knj->kni", jacobian, turned)
    miss = np.linalg.norm(imposed - forces.wall_deflection, axis=-1)
    yield judge_worst("stiffness.joint_command", miss, subject.at)
    commanded = limbs_at(robot, instants.com, subject.axes, forces.joint_command)
    miss = np.linalg.norm(forces.toe_command - commanded.toe, axis=-1)
    yield judge_worst("stiffness.command", miss, subject.at)


def _stored_factors(subject: Subject) -> Check:
    """Safety factors as fractions of what is allowed, so that infinite factors compare as zero."""
    plan = subject.plan
    forces, instants = plan.forces, plan.instants
    normal, tangent = subject.contact_force, subject.tangential_force
    critical = np.where(instants.contact, _share(tangent, normal), 0.0)
    if forces.corner_force is not None:  # of the corner that slips first
        share = _share(*reversed(parted(forces.corner_force, instants.normal)))
        critical = np.where(instants.contact, share.max(axis=-1), 0.0)
    held = subject.torques + subject.link_torques
    torque = (np.abs(held) / plan.robot.max_torque).max(axis=(1, 2))
    friction = _share(critical, instants.mu).max(axis=1)
    off = np.stack(
        [
            np.abs(1 / forces.safety_torque - torque),
            np.abs(1 / forces.safety_friction - friction),
            np.abs(forces.mu_critical - critical).max(axis=1),
        ],
        axis=1,
    )
    names = ("safety_torque", "safety_friction", "mu_critical")
    return judge_worst("safety.stored", off, lambda k, row: f"{subject.at(k)}, {names[row]}")


def _share(used: Array, allowed: Array) -> Array:
    """used / allowed; 0 if nothing is used, infinite if nothing is allowed."""
    ratio = np.full(np.broadcast(used, allowed).shape, np.inf)
    np.divide(used, allowed, out=ratio, where=allowed > 0)
    return np.where(used == 0, 0.0, ratio)


def _inverse(use: float) -> float:
    return float("inf") if use == 0 else 1.0 / float(use)
