"""The exact check of a walking trajectory: nonlinear dynamics, contact, friction, workspace.

It checks the answers of every method and every plan file, and shares no code with solvers.

Table numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.terrain.raw_surface import RawSurface
from climbplan.verification.check import Check, Limit, mark_unjudged
from climbplan.walking.check.reference_dynamics import (
    integrate_continuously,
    integrate_knot,
    transform_toes_to_body,
)
from climbplan.walking.check.scan import (
    compute_depth,
    compute_stance_error,
    compute_swing_deficit,
)
from climbplan.walking.check.speed import generate_speed_residuals
from climbplan.walking.check.terrain import (
    compute_clearance_height,
    compute_ground_height,
    compute_region_error,
    split_force,
)
from climbplan.walking.check.torque import generate_torque_residuals
from climbplan.walking.task.task import (
    ANGLE_RANGE,
    ANGLES,
    POSITION,
    SPIN,
    VELOCITY,
    WalkTask,
    WalkTrajectory,
)

LIMITS = {
    "start.state": Limit(1e-9, "", "the first state and toes are those of the task"),
    "dynamics.position": Limit(1e-6, "m", "positions follow from velocities"),
    "dynamics.velocity": Limit(1e-6, "m/s", "velocities follow from forces and weight"),
    "dynamics.attitude": Limit(1e-6, "rad", "Euler angles follow from the angular velocity"),
    "dynamics.angular_velocity": Limit(1e-6, "rad/s", "angular velocities follow from moments"),
    "rollout.velocity": Limit(
        0.05, "m/s", "velocities that forces alone give over 400 ms are the plan's"
    ),
    "rollout.attitude": Limit(
        0.05, "rad", "attitudes that forces alone give over 400 ms are the plan's"
    ),
    "continuous.velocity": Limit(0.05, "m/s", "the same velocities in continuous time"),
    "continuous.attitude": Limit(0.05, "rad", "the same attitudes in continuous time"),
    "force.without_contact": Limit(1e-9, "N", "no force on swinging legs"),
    "force.friction": Limit(1e-4, "N", "force along a region within mu times that into it"),
    "force.limit": Limit(1e-4, "N", "components of forces within their limit"),
    "contact.no_slip": Limit(1e-9, "m", "standing toes stay where they are"),
    "contact.region": Limit(1e-6, "m", "standing toes are on their regions"),
    "swing.clearance": Limit(1e-6, "m", "swinging toes are lifted above all ground on their ways"),
    "workspace.over_stance": Limit(
        1e-4, "m", "standing toes are inside their boxes at the interval's end too"
    ),
    "workspace.toe": Limit(1e-4, "m", "toes are inside their boxes in the body frame"),
    "state.tilt": Limit(0, "rad", "roll and pitch within a right angle"),
    "goal.position": Limit(1e-4, "m", "the body is at its goal at the end"),
    "gait.contacts": Limit(0, "", "intervals with fewer standing legs than `task.min_contacts`"),
}
LEG_LIMITS = {  # of robots from URDFs, whose plans have joints
    "stance.reach": Limit(
        1e-6, "m", "joints within their bounds get standing toes to where they are"
    ),
    "torque.limit": Limit(1e-3, "N m", "joint torques of standing legs, J' f, within their limits"),
    "swing.reach": Limit(
        1e-3, "m", "joints within their bounds get swinging toes along their ways"
    ),
    "speed.limit": Limit(1e-3, "rad/s", "joint speeds of standing and swinging legs within limits"),
}
SCANNED_LIMITS = {  # of walks on scanned terrain
    "scan.toes": Limit(
        1e-6, "m", "standing toes within `terrain.scan.flatness` of the raw surface, beyond it"
    ),
    "scan.swing": Limit(1e-6, "m", "swinging toes are lifted above the raw surface on their ways"),
    "scan.penetration": Limit(
        0.02, "m", "swinging toes are never in the raw surface, at every sample"
    ),
}
LOOP_LIMITS = {
    "workspace.standing": Limit(
        0.02, "m", "standing toes at most so far outside their boxes, at every sample"
    ),
    "swing.penetration": Limit(1e-6, "m", "swinging toes are never in the ground, at every sample"),
    "loop.upright": Limit(1.05, "rad", "the body never tips over"),
    "loop.height": Limit(0.0, "m", "the body never sinks to two fifths of its height above toes"),
}
_MIN_HEIGHT_RATIO = 0.42  # of the depth of toe boxes below the body
WINDOW = 0.4  # [s] of the rollouts
EULER = "forward Euler"  # of the badge
_AT_KNOTS = {
    "velocity": "holds at knots only: in continuous time the velocity is off by up to {figure} "
    "within 400 ms",
    "attitude": "holds at knots only: in continuous time the attitude is off by up to {figure} "
    "within 400 ms",
}
KNOTS = "workspace at knots"
_REACH = "toes leave their boxes by up to {figure} before they lift"


def check_trajectory(task: WalkTask, trajectory: WalkTrajectory) -> tuple[Check, ...]:
    """Return all checks of a trajectory, some of them informational.

    Informational are those of continuous time for forward Euler. Without `workspace_over_stance` so
    are those of standing toes at the end of their intervals.
    """
    with np.errstate(all="ignore"):  # absurd numbers become infinite or NaN and fail
        return tuple(_generate_checks(task, trajectory))


def is_feasible(task: WalkTask, trajectory: WalkTrajectory) -> bool:
    """Return whether all checks but informational ones pass; it stops at the first failure."""
    with np.errstate(all="ignore"):
        return all(
            check.passed for check in _generate_checks(task, trajectory, include_unjudged=False)
        )


def check_loop(task: WalkTask, trajectory: WalkTrajectory, push: Array) -> tuple[Check, ...]:
    """Return all checks of the samples of a closed loop.

    Args:
        task: The task, with one knot for each sample.
        trajectory: The samples.
        push: Velocity changes of the body by disturbances (T, 3) [m/s].
    """
    with np.errstate(all="ignore"):
        return tuple(_generate_loop_checks(task, trajectory, push))


def format_failures(checks: tuple[Check, ...]) -> str:
    """Return the failed checks as a text; empty if all pass."""
    return "; ".join(
        f"{check.name} {check.residual:.2g} {check.unit} at {check.worst_at}".rstrip()
        for check in checks
        if not check.passed
    )


def _generate_checks(
    task: WalkTask, trajectory: WalkTrajectory, include_unjudged: bool = True
) -> Iterator[Check]:
    """Yield the checks of a trajectory."""
    state, toes, force = trajectory.state, trajectory.toes, trajectory.force
    at_start = np.abs(state[0] - task.start.state).max(), np.abs(toes[0] - task.start.toes).max()
    yield build_check("start.state", max(at_start))
    after = integrate_knot(task.body, task.integrator, task.dt, state[:-1], toes[:-1], force[:-1])
    yield from _check_dynamics(task, after, state)
    yield from _check_rollouts(task, trajectory, include_unjudged)
    yield from _check_forces(task, trajectory)
    yield from _check_joints(task, trajectory)
    yield from _check_feet(task, trajectory, include_unjudged)
    tilt = np.abs(state[:, 6:8]).max(axis=1)
    yield build_worst_check(task, "state.tilt", tilt - ANGLE_RANGE, tilt / ANGLE_RANGE)
    if np.isfinite([*task.goal.lower, *task.goal.upper]).any():
        end = state[-1, :2]
        yield build_check("goal.position", max(*(task.goal.lower - end), *(end - task.goal.upper)))
    missing = np.maximum(task.min_contacts - trajectory.gait.contact[:-1].sum(axis=1), 0)
    yield build_worst_check(task, "gait.contacts", missing.astype(float))


def _generate_loop_checks(
    task: WalkTask, trajectory: WalkTrajectory, push: Array
) -> Iterator[Check]:
    """Yield the checks of the samples of a closed loop."""
    state, toes, force, contact = (
        trajectory.state,
        trajectory.toes,
        trajectory.force,
        trajectory.gait.contact,
    )
    first_state = state[0].copy()
    first_state[VELOCITY] -= push[0]
    at_start = np.abs(first_state - task.start.state).max(), np.abs(toes[0] - task.start.toes).max()
    yield build_check("start.state", max(at_start))
    after = integrate_knot(task.body, task.integrator, task.dt, state[:-1], toes[:-1], force[:-1])
    after[:, VELOCITY] += push[1:]
    yield from _check_dynamics(task, after, state)
    yield from _check_forces(task, trajectory)
    yield from _check_joints(task, trajectory)
    stays = contact[:-1] & contact[1:]
    slip = np.where(stays, np.abs(np.diff(toes, axis=0)).max(axis=-1), 0.0)
    yield build_worst_check(task, "contact.no_slip", slip)
    since_start = np.logical_and.accumulate(contact, axis=0)
    region_error = compute_region_error(task.ground, trajectory.gait.region, toes, since_start)
    yield build_worst_check(task, "contact.region", np.where(contact, region_error, 0.0))
    depth = np.maximum(compute_ground_height(task.ground, toes[..., :2]) - toes[..., 2], 0.0)
    yield build_worst_check(task, "swing.penetration", np.where(contact, 0.0, depth))
    scan = task.ground.scan
    if scan is not None:
        yield _check_scanned_stance(task, trajectory, scan)
        depth = np.where(contact, 0.0, compute_depth(toes, scan))
        yield build_worst_check(task, "scan.penetration", depth)
    toes_in_box = transform_toes_to_body(state, toes)
    beyond = (np.abs(toes_in_box - task.body.toe_center) - task.body.toe_half).max(axis=-1)
    yield build_worst_check(task, "workspace.standing", np.where(contact, beyond, -1.0))
    tilt = np.abs(state[:, 6:8]).max(axis=1)
    yield build_worst_check(task, "loop.upright", np.where(np.isfinite(tilt), tilt, np.inf))
    min_height = -_MIN_HEIGHT_RATIO * task.body.toe_center[:, 2].mean()
    depth = min_height - (state[:, 2] - toes[..., 2].min(axis=1))
    yield build_worst_check(task, "loop.height", np.where(np.isfinite(depth), depth, np.inf))


def _check_dynamics(task: WalkTask, after: Array, state: Array) -> Iterator[Check]:
    """Yield the residuals of the dynamics, by part of the state."""
    error = np.abs(after - state[1:])
    for name, component in (
        ("position", POSITION),
        ("velocity", VELOCITY),
        ("attitude", ANGLES),
        ("angular_velocity", SPIN),
    ):
        yield build_worst_check(task, f"dynamics.{name}", error[:, component].max(axis=1))


def _check_rollouts(
    task: WalkTask, trajectory: WalkTrajectory, include_unjudged: bool
) -> Iterator[Check]:
    """Yield checks of rollouts from each knot by its own forces for 400 ms.

    Rollouts are in knots, and in continuous time.

    Args:
        task: The task.
        trajectory: The trajectory.
        include_unjudged: Also roll out in continuous time where that is informational.
    """
    span = max(1, min(round(WINDOW / task.dt), task.knots))
    first_knots = np.arange(0, task.knots - span + 1)
    window = first_knots + np.arange(span)[:, None]  # (span, B)
    toes, force = trajectory.toes[window], trajectory.force[window]
    states = [trajectory.state[first_knots]]
    for n in range(span):
        states.append(
            integrate_knot(task.body, task.integrator, task.dt, states[n], toes[n], force[n])
        )
    rolls = [("rollout", np.stack(states))]
    if include_unjudged or task.integrator != "euler":
        continuous = integrate_continuously(
            task.body, task.dt, trajectory.state[first_knots], toes, force
        )
        rolls.append(("continuous", continuous))
    planned = trajectory.state[np.concatenate([window, window[-1:] + 1])]
    for kind, rolled in rolls:
        error = np.abs(rolled - planned).max(axis=0)  # (B, 12)
        for name, component in (("velocity", VELOCITY), ("attitude", ANGLES)):
            check = build_worst_check(task, f"{kind}.{name}", error[:, component].max(axis=1))
            if kind == "continuous" and task.integrator == "euler":
                check = mark_unjudged(check, "forward Euler", EULER, _AT_KNOTS[name])
            yield check


def _check_forces(task: WalkTask, trajectory: WalkTrajectory) -> Iterator[Check]:
    """Yield checks of swinging legs, friction cones and force limits."""
    force, contact = trajectory.force, trajectory.gait.contact
    size = np.linalg.norm(force, axis=-1)
    yield build_worst_check(task, "force.without_contact", np.where(contact, 0.0, size))
    # Friction cones are about the normals of their regions
    normal_force, tangential_force = split_force(task.ground, trajectory.gait.region, force)
    max_tangential = task.ground.friction * normal_force
    if task.ground.region_friction.size:
        max_tangential = task.ground.region_friction[trajectory.gait.region] * normal_force
    used_fraction = np.where(size > 1e-3, tangential_force / np.maximum(max_tangential, 1e-9), 0.0)
    # A negative normal force pulls at the ground.
    yield build_worst_check(
        task,
        "force.friction",
        np.maximum(tangential_force - max_tangential, -normal_force),
        used_fraction,
    )
    largest = np.abs(force).max(axis=-1)
    limit = task.body.force_limit
    yield build_worst_check(task, "force.limit", largest - limit, largest / limit)


def _check_joints(task: WalkTask, trajectory: WalkTrajectory) -> Iterator[Check]:
    """Yield checks of joint torques and speeds."""
    for residuals_of in (generate_torque_residuals, generate_speed_residuals):
        yield from (
            build_worst_check(task, *residuals) for residuals in residuals_of(task, trajectory)
        )


def _check_feet(
    task: WalkTask, trajectory: WalkTrajectory, include_unjudged: bool
) -> Iterator[Check]:
    """Yield checks of no slip, regions, clearance and workspace."""
    toes, contact, region = trajectory.toes, trajectory.gait.contact, trajectory.gait.region
    stays = contact[:-1] & contact[1:]
    slip = np.where(stays, np.abs(np.diff(toes, axis=0)).max(axis=-1), 0.0)
    yield build_worst_check(task, "contact.no_slip", slip)
    since_start = np.logical_and.accumulate(contact, axis=0)
    region_error = compute_region_error(task.ground, region, toes, since_start)
    yield build_worst_check(task, "contact.region", np.where(contact, region_error, 0.0))
    missing_height = (
        compute_clearance_height(task.ground, toes, contact) + task.swing_clearance - toes[..., 2]
    )
    # The first toes are given: legs that swing from the start are lifted after them.
    swinging = ~contact
    swinging[0] = False
    yield build_worst_check(
        task, "swing.clearance", np.where(swinging, np.maximum(missing_height, 0.0), 0.0)
    )
    scan = task.ground.scan
    if scan is not None:
        yield _check_scanned_stance(task, trajectory, scan)
        deficit = compute_swing_deficit(task, trajectory, scan)
        yield build_worst_check(task, "scan.swing", deficit)
    toes_in_box = transform_toes_to_body(trajectory.state, toes)
    if task.workspace_over_stance or include_unjudged:
        after = transform_toes_to_body(trajectory.state[1:], toes[:-1])
        violation_after = (np.abs(after - task.body.toe_center) - task.body.toe_half).max(axis=-1)
        stance_check = build_worst_check(
            task, "workspace.over_stance", np.where(contact[:-1], violation_after, -1.0)
        )
        if not task.workspace_over_stance:
            stance_check = mark_unjudged(
                stance_check, "task.workspace_over_stance is not asked", KNOTS, _REACH
            )
        yield stance_check
    violation = np.abs(toes_in_box - task.body.toe_center) - task.body.toe_half
    max_violation = violation.max(axis=-1)
    used_fraction = (1.0 + violation / task.body.toe_half).max(axis=-1)
    is_counted = contact.copy()
    is_counted[1:] = True
    used_fraction = np.where(is_counted, used_fraction, 0.0)
    yield build_worst_check(
        task, "workspace.toe", np.where(is_counted, max_violation, -1.0), used_fraction
    )


def _check_scanned_stance(task: WalkTask, trajectory: WalkTrajectory, scan: RawSurface) -> Check:
    """Return the check of standing toes against the raw surface of a scan."""
    distance = compute_stance_error(task, trajectory, scan)
    return build_worst_check(task, "scan.toes", distance - scan.flatness, distance / scan.flatness)


def build_worst_check(
    task: WalkTask, name: str, residuals: Array, used_fraction: Array | None = None
) -> Check:
    """Return the check of the worst residual, with its time and leg.

    Args:
        task: The task.
        name: Name of the check.
        residuals: Residuals by knot (n,), or by knot and leg (n, L); NaN is the worst.
        used_fraction: Fraction of the limit that is used, of the same shape.
    """
    values = np.where(np.isnan(residuals), np.inf, residuals)
    index = np.unravel_index(int(np.argmax(values)), values.shape)
    check = build_check(name, float(values[index]))
    if check.passed and used_fraction is not None:
        index = np.unravel_index(int(np.argmax(used_fraction)), used_fraction.shape)
        check = replace(check, used=min(float(used_fraction[index]), 1.0))
    if check.residual <= 0 and used_fraction is None:
        return check
    place = f"{task.dt * index[0]:.2f} s"
    if len(index) > 1:
        place = f"{place}, {task.body.leg_names[index[1]]}"
    return replace(check, worst_at=place)


def build_check(name: str, residual: float) -> Check:
    """Return a check by its name in `LIMITS`; NaN never passes."""
    limit = (LIMITS | LEG_LIMITS | SCANNED_LIMITS | LOOP_LIMITS)[name]
    residual = float(residual) + 0.0
    if math.isnan(residual):
        residual = math.inf
    return Check(name, residual, limit.value, limit.unit, residual <= limit.value, "", "")
