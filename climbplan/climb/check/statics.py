"""What the joint commands do: the pose, forces and stability of the nonlinear static equilibrium.

Commands that hold the body at its planned pose must do so exactly. Where the body is to sag
(`force.deflection_compensation: predicted`), plan and commands follow the linear model of eq. (4.14), of which the
equilibrium is no consequence: it is looked for and told, but not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.feet import foot_arm, rolling
from climbplan.climb.check.anew.kinematics import turned
from climbplan.climb.check.anew.soles import corners_of_wrench, lying
from climbplan.climb.check.anew.static_pose import Braced, Settled, settle
from climbplan.climb.check.friction_factor import friction_factor, least_factor
from climbplan.climb.check.robust import robust_checks
from climbplan.climb.check.soles import parted
from climbplan.climb.check.subject import Subject
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.robots.joint_units import format_largest_torques
from climbplan.verification.check import Check, judge_worst, unjudged

LINEAR = "force.deflection_compensation: predicted is a linear model"
MODEL = "linear sag"  # of the badge
LACKS = {
    "static.pose": "joints that are springs hold the body elsewhere than planned: {figure}",
    "static.torque": "torques there exceed their limit over S_tau: {figure}",
    "static.friction": "forces there leave their friction cones over S_mu: {figure}",
    "static.stability": "the body buckles under the forces that hold it",
    "trajectory.command": "commands on the way hold the body off its path: {figure}",
    "trajectory.friction": "forces on the way leave their friction cones: {figure}",
    "trajectory.torque": "torques on the way exceed their limit: {figure}",
}


def static_checks(subject: Subject, margins: MarginsSpec | None = None) -> Iterator[Check]:
    """Pose, torques, friction, stability at every instant, and the spec's margins of them."""
    settled = _settled(subject)
    for check in _checks(subject, settled):
        yield told_of_sag(check) if subject.sags else check
    if not subject.sags:
        yield from robust_checks(subject, settled, margins)


def told_of_sag(check: Check) -> Check:
    """A check of what springs really do, in a plan that follows the linear model of its sag."""
    return unjudged(check, LINEAR, MODEL, LACKS.get(check.name, f"{check.name} {{figure}}"))


def _settled(subject: Subject) -> Settled:
    """Where the commands hold the body."""
    plan = subject.plan
    robot, instants, forces = plan.robot, plan.instants, plan.forces
    sag = forces.com_deflection
    angle = np.linalg.norm(sag[:, 3:], axis=1)
    axis = sag[:, 3:] / np.maximum(angle, 1e-300)[:, None]
    axes = turned(subject.axes, axis[:, None, :], angle[:, None])
    braced = Braced(
        rolling(robot, subject.axes, instants.joint_angles, instants.normal),
        instants.toes + foot_arm(robot, instants.normal),
        instants.contact,
        forces.joint_command,
        instants.joint_angles,
        subject.load,
        subject.wrist_moment if plan.robot.gripper is not None else None,
        None if robot.sole is None else lying(robot.sole, instants.normal),
    )
    return settle(braced, instants.com + sag[:, :3], axes)


def _checks(subject: Subject, settled: Settled) -> Iterator[Check]:
    plan = subject.plan
    robot = plan.robot
    shift = np.linalg.norm(settled.shift, axis=1)
    turn = np.linalg.norm(settled.turn, axis=1)
    lost = np.isnan(shift)
    off = np.stack([shift, turn], axis=1)
    names = ("shifted", "turned")
    yield judge_worst(
        "static.pose",
        np.where(np.isnan(off), np.inf, off),
        lambda k, row: f"{subject.at(k)}, {names[row]}",
        margin=f"{1e3 * _largest(shift):.3f} mm, {np.rad2deg(_largest(turn)):.3f} deg"
        + (f", none at {int(lost.sum())} instants" if lost.any() else ""),
    )

    asked = plan.limits.safety_torque
    held = settled.torque + subject.link_torques
    use = np.abs(held) / robot.max_torque
    yield judge_worst(
        "static.torque",
        use - 1 / asked,
        subject.at,
        margin=f"at most {format_largest_torques(robot, held)}",
        used=use * asked,
    )

    if plan.robot.gripper is None:
        yield _friction(subject, settled)
    left = settled.stiffness_left
    least = float(np.min(left, initial=1.0, where=np.isfinite(left)))
    yield judge_worst(
        "static.stability",
        -left,
        subject.at,
        margin=f"{100 * least:.0f} % of the stiffness left",
        used=1.0 - left,
    )


def _friction(subject: Subject, settled: Settled) -> Check:
    """Contact forces where the body settles, within their cones over S_mu."""
    plan, instants = subject.plan, subject.plan.instants
    asked = plan.limits.safety_friction
    sole, stored = plan.robot.sole, plan.forces.corner_force
    contact, mu = instants.contact, instants.mu
    at: Callable[..., str] = subject.at
    normal = np.einsum("kni,kni->kn", settled.force, instants.normal)
    tangent = np.linalg.norm(settled.force - normal[..., None] * instants.normal, axis=-1)
    if sole is not None and stored is not None:  # each corner for itself
        axes = lying(sole, instants.normal)
        pushes = corners_of_wrench(sole, axes, stored, settled.force, settled.moment)
        normal, tangent = parted(pushes, instants.normal)
        contact, mu, at = contact[..., None], mu[..., None], subject.at_corner
    held = mu * normal
    excess = np.where(contact, tangent - held / asked, -np.inf)
    factor = friction_factor("static.friction", tangent, held, subject.weight)
    factor = np.where(contact, factor, np.inf)
    return judge_worst(
        "static.friction",
        excess / subject.weight,
        at,
        margin=least_factor(factor),
        used=asked / np.maximum(factor, 1e-300),
    )


def _largest(values: Array) -> float:
    """Largest of what is there."""
    return float(np.max(values, initial=0.0, where=np.isfinite(values)))
