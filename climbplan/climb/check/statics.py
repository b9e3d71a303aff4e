"""Checks of the nonlinear static equilibrium under the joint commands: pose, forces, stability.

Commands that hold the body at its planned pose must do so exactly. With
`force.deflection_compensation: predicted`, plan and commands follow the linear model of eq. (4.14),
which does not imply the equilibrium. The equilibrium is then computed and reported, but not judged.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.feet import build_rolling_robot, compute_contact_arm
from climbplan.climb.check.anew.kinematics import rotate
from climbplan.climb.check.anew.soles import compute_sole_axes, fit_corner_forces
from climbplan.climb.check.anew.static_pose import BracedRobot, StaticEquilibrium, solve_equilibrium
from climbplan.climb.check.friction_factor import compute_friction_factor, format_min_factor
from climbplan.climb.check.robust import check_margins
from climbplan.climb.check.soles import split_pressure_shear
from climbplan.climb.check.subject import Subject
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.robots.joint_units import format_largest_torques
from climbplan.verification.check import Check, judge_worst, mark_unjudged

LINEAR_MODEL = "force.deflection_compensation: predicted is a linear model"
MODEL_NAME = "linear sag"  # of the badge
SHORTCOMINGS = {
    "static.pose": "joints that are springs hold the body elsewhere than planned: {figure}",
    "static.torque": "torques there exceed their limit over S_tau: {figure}",
    "static.friction": "forces there leave their friction cones over S_mu: {figure}",
    "static.stability": "the body buckles under the forces that hold it",
    "trajectory.command": "commands on the way hold the body off its path: {figure}",
    "trajectory.friction": "forces on the way leave their friction cones: {figure}",
    "trajectory.torque": "torques on the way exceed their limit: {figure}",
}


def check_statics(subject: Subject, margins: MarginsSpec | None = None) -> Iterator[Check]:
    """Yield checks of pose, torques, friction, stability and margins at every instant."""
    equilibrium = _solve_equilibrium(subject)
    for check in _check_equilibrium(subject, equilibrium):
        yield mark_linear_model(check) if subject.predicts_deflection else check
    if not subject.predicts_deflection:
        yield from check_margins(subject, equilibrium, margins)


def mark_linear_model(check: Check) -> Check:
    """Mark a check of exact springs as informational, in a plan that follows the linear model."""
    return mark_unjudged(
        check, LINEAR_MODEL, MODEL_NAME, SHORTCOMINGS.get(check.name, f"{check.name} {{figure}}")
    )


def _solve_equilibrium(subject: Subject) -> StaticEquilibrium:
    """Return the equilibria in which the commands hold the body."""
    plan = subject.plan
    robot, instants, forces = plan.robot, plan.instants, plan.forces
    deflection = forces.com_deflection
    angle = np.linalg.norm(deflection[:, 3:], axis=1)
    axis = deflection[:, 3:] / np.maximum(angle, 1e-300)[:, None]
    axes = rotate(subject.axes, axis[:, None, :], angle[:, None])
    braced = BracedRobot(
        build_rolling_robot(robot, subject.axes, instants.joint_angles, instants.normal),
        instants.toes + compute_contact_arm(robot, instants.normal),
        instants.contact,
        forces.joint_command,
        instants.joint_angles,
        subject.load,
        subject.wrist_moment if plan.robot.gripper is not None else None,
        None if robot.sole is None else compute_sole_axes(robot.sole, instants.normal),
    )
    return solve_equilibrium(braced, instants.com + deflection[:, :3], axes)


def _check_equilibrium(subject: Subject, equilibrium: StaticEquilibrium) -> Iterator[Check]:
    """Yield the checks of the equilibria."""
    plan = subject.plan
    robot = plan.robot
    shift = np.linalg.norm(equilibrium.shift, axis=1)
    turn = np.linalg.norm(equilibrium.turn, axis=1)
    is_lost = np.isnan(shift)
    displacement = np.stack([shift, turn], axis=1)
    names = ("shifted", "turned")
    yield judge_worst(
        "static.pose",
        np.where(np.isnan(displacement), np.inf, displacement),
        lambda k, row: f"{subject.describe_instant(k)}, {names[row]}",
        margin=f"{1e3 * _find_max_finite(shift):.3f} mm, "
        f"{np.rad2deg(_find_max_finite(turn)):.3f} deg"
        + (f", none at {int(is_lost.sum())} instants" if is_lost.any() else ""),
    )

    required = plan.limits.safety_torque
    motor_torque = equilibrium.torque + subject.link_torques
    torque_ratio = np.abs(motor_torque) / robot.max_torque
    yield judge_worst(
        "static.torque",
        torque_ratio - 1 / required,
        subject.describe_instant,
        margin=f"at most {format_largest_torques(robot, motor_torque)}",
        used=torque_ratio * required,
    )

    if plan.robot.gripper is None:
        yield _check_friction(subject, equilibrium)
    stiffness_ratio = equilibrium.stiffness_ratio
    min_ratio = float(np.min(stiffness_ratio, initial=1.0, where=np.isfinite(stiffness_ratio)))
    yield judge_worst(
        "static.stability",
        -stiffness_ratio,
        subject.describe_instant,
        margin=f"{100 * min_ratio:.0f} % of the stiffness left",
        used=1.0 - stiffness_ratio,
    )


def _check_friction(subject: Subject, equilibrium: StaticEquilibrium) -> Check:
    """Check contact forces in equilibrium against their cones over S_mu."""
    plan, instants = subject.plan, subject.plan.instants
    required = plan.limits.safety_friction
    sole, stored = plan.robot.sole, plan.forces.corner_force
    contact, mu = instants.contact, instants.mu
    describe_place: Callable[..., str] = subject.describe_instant
    normal = np.einsum("kni,kni->kn", equilibrium.force, instants.normal)
    tangent = np.linalg.norm(equilibrium.force - normal[..., None] * instants.normal, axis=-1)
    if sole is not None and stored is not None:  # each corner for itself
        axes = compute_sole_axes(sole, instants.normal)
        corner_forces = fit_corner_forces(sole, axes, stored, equilibrium.force, equilibrium.moment)
        normal, tangent = split_pressure_shear(corner_forces, instants.normal)
        contact, mu, describe_place = contact[..., None], mu[..., None], subject.describe_corner
    max_shear = mu * normal
    excess = np.where(contact, tangent - max_shear / required, -np.inf)
    factor = compute_friction_factor("static.friction", tangent, max_shear, subject.weight)
    factor = np.where(contact, factor, np.inf)
    return judge_worst(
        "static.friction",
        excess / subject.weight,
        describe_place,
        margin=format_min_factor(factor),
        used=required / np.maximum(factor, 1e-300),
    )


def _find_max_finite(values: Array) -> float:
    """Return the largest finite value."""
    return float(np.max(values, initial=0.0, where=np.isfinite(values)))
