"""The exact check of a walking trajectory: nonlinear dynamics, contact, friction, workspace.

Every method is judged by it, and so is every plan file. It uses nothing that solvers use.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.verification.check import Check, Limit, unjudged
from climbplan.walking.check.speed import speed_residuals
from climbplan.walking.check.terrain import (
    ground_at,
    normal_and_sideways,
    off_region,
    to_clear,
)
from climbplan.walking.check.torque import torque_residuals
from climbplan.walking.check.truth import continuous_rollout, knot_step, toes_in_body
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
    "dynamics.spin": Limit(1e-6, "rad/s", "angular velocities follow from moments"),
    "rollout.velocity": Limit(0.05, "m/s", "forces alone, over 400 ms, lead where the plan says"),
    "rollout.attitude": Limit(0.05, "rad", "and turn the body as the plan says"),
    "continuous.velocity": Limit(0.05, "m/s", "and so they do in continuous time"),
    "continuous.attitude": Limit(0.05, "rad", "and so they do in continuous time"),
    "force.swing": Limit(1e-9, "N", "no force on swinging legs"),
    "force.friction": Limit(1e-4, "N", "force along a region within mu times that into it"),
    "force.limit": Limit(1e-4, "N", "components of forces within their limit"),
    "contact.no_slip": Limit(1e-9, "m", "standing toes stay where they are"),
    "contact.region": Limit(1e-6, "m", "standing toes are on their regions"),
    "swing.height": Limit(1e-6, "m", "swinging toes are lifted above all ground on their ways"),
    "workspace.whole_stance": Limit(
        1e-4, "m", "standing toes are inside their boxes at the interval's end too"
    ),
    "workspace.toe": Limit(1e-4, "m", "toes are inside their boxes in the body frame"),
    "state.tilt": Limit(0, "rad", "roll and pitch within a right angle (Table 8.4)"),
    "goal.position": Limit(1e-4, "m", "the body is at its goal at the end"),
    "gait.contacts": Limit(0, "", "intervals with fewer standing legs than asked for"),
}
LEG_LIMITS = {  # of robots from URDFs, whose plans have joints
    "torque.reach": Limit(
        1e-6, "m", "joints within their bounds get standing toes to where they are"
    ),
    "torque.limit": Limit(1e-3, "N m", "joint torques of standing legs, J' f, within their limits"),
    "swing.reach": Limit(
        1e-3, "m", "joints within their bounds get swinging toes along their ways"
    ),
    "speed.limit": Limit(1e-3, "rad/s", "joint speeds of standing and swinging legs within limits"),
}
LOOP_LIMITS = {
    "workspace.standing": Limit(
        0.02, "m", "standing toes at most so far outside their boxes, at every sample"
    ),
    "swing.ground": Limit(1e-6, "m", "swinging toes are never in the ground, at every sample"),
    "loop.upright": Limit(1.05, "rad", "the body never tips over"),
    "loop.height": Limit(0.0, "m", "the body never sinks to two fifths of its height above toes"),
}
_SUNK = 0.42  # of how far toes' boxes lie below the body
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


def check_trajectory(task: WalkTask, found: WalkTrajectory) -> tuple[Check, ...]:
    """All checks; some are told but not judged.

    For forward Euler those of continuous time, and without `whole_stance` where standing toes are
    at the end of their intervals.
    """
    with np.errstate(all="ignore"):  # absurd numbers become infinite or NaN and fail
        return tuple(_checks(task, found))


def passes(task: WalkTask, found: WalkTrajectory) -> bool:
    """Whether all checks pass that are judged; up to the first that does not."""
    with np.errstate(all="ignore"):
        return all(check.passed for check in _checks(task, found, told=False))


def check_loop(task: WalkTask, found: WalkTrajectory, push: Array) -> tuple[Check, ...]:
    """All checks of a closed loop's samples; push (T, 3): outside changes of velocity [m/s]."""
    with np.errstate(all="ignore"):
        return tuple(_loop_checks(task, found, push))


def failures(checks: tuple[Check, ...]) -> str:
    """The failed checks in words; empty if all pass."""
    return "; ".join(
        f"{check.name} {check.residual:.2g} {check.unit} at {check.worst_at}".rstrip()
        for check in checks
        if not check.passed
    )


def _checks(task: WalkTask, found: WalkTrajectory, told: bool = True) -> Iterator[Check]:
    state, toes, force = found.state, found.toes, found.force
    at_start = np.abs(state[0] - task.start.state).max(), np.abs(toes[0] - task.start.toes).max()
    yield judge("start.state", max(at_start))
    after = knot_step(task.body, task.integrator, task.step, state[:-1], toes[:-1], force[:-1])
    yield from _steps(task, after, state)
    yield from _rollouts(task, found, told)
    yield from _forces(task, found)
    yield from _joints(task, found)
    yield from _feet(task, found, told)
    tilt = np.abs(state[:, 6:8]).max(axis=1)
    yield worst(task, "state.tilt", tilt - ANGLE_RANGE, tilt / ANGLE_RANGE)
    if np.isfinite([*task.goal.lower, *task.goal.upper]).any():
        end = state[-1, :2]
        yield judge("goal.position", max(*(task.goal.lower - end), *(end - task.goal.upper)))
    missing = np.maximum(task.least_contacts - found.gait.contact[:-1].sum(axis=1), 0)
    yield worst(task, "gait.contacts", missing.astype(float))


def _loop_checks(task: WalkTask, found: WalkTrajectory, push: Array) -> Iterator[Check]:
    state, toes, force, contact = found.state, found.toes, found.force, found.gait.contact
    begun = state[0].copy()
    begun[VELOCITY] -= push[0]
    at_start = np.abs(begun - task.start.state).max(), np.abs(toes[0] - task.start.toes).max()
    yield judge("start.state", max(at_start))
    after = knot_step(task.body, task.integrator, task.step, state[:-1], toes[:-1], force[:-1])
    after[:, VELOCITY] += push[1:]
    yield from _steps(task, after, state)
    yield from _forces(task, found)
    yield from _joints(task, found)
    stays = contact[:-1] & contact[1:]
    slip = np.where(stays, np.abs(np.diff(toes, axis=0)).max(axis=-1), 0.0)
    yield worst(task, "contact.no_slip", slip)
    since_start = np.logical_and.accumulate(contact, axis=0)
    off = off_region(task.ground, found.gait.region, toes, since_start)
    yield worst(task, "contact.region", np.where(contact, off, 0.0))
    sunk = np.maximum(ground_at(task.ground, toes[..., :2]) - toes[..., 2], 0.0)
    yield worst(task, "swing.ground", np.where(contact, 0.0, sunk))
    spots = toes_in_body(state, toes)
    beyond = (np.abs(spots - task.body.toe_center) - task.body.toe_half).max(axis=-1)
    yield worst(task, "workspace.standing", np.where(contact, beyond, -1.0))
    tilt = np.abs(state[:, 6:8]).max(axis=1)
    yield worst(task, "loop.upright", np.where(np.isfinite(tilt), tilt, np.inf))
    least = -_SUNK * task.body.toe_center[:, 2].mean()
    sunk = least - (state[:, 2] - toes[..., 2].min(axis=1))
    yield worst(task, "loop.height", np.where(np.isfinite(sunk), sunk, np.inf))


def _steps(task: WalkTask, after: Array, state: Array) -> Iterator[Check]:
    off = np.abs(after - state[1:])
    for name, part in (
        ("position", POSITION),
        ("velocity", VELOCITY),
        ("attitude", ANGLES),
        ("spin", SPIN),
    ):
        yield worst(task, f"dynamics.{name}", off[:, part].max(axis=1))


def _rollouts(task: WalkTask, found: WalkTrajectory, told: bool) -> Iterator[Check]:
    """From each knot on its own forces for 400 ms: in knots, and in continuous time.

    told: also in continuous time where that is not judged.
    """
    span = max(1, min(round(WINDOW / task.step), task.knots))
    begins = np.arange(0, task.knots - span + 1)
    window = begins + np.arange(span)[:, None]  # (span, B)
    toes, force = found.toes[window], found.force[window]
    states = [found.state[begins]]
    for n in range(span):
        states.append(
            knot_step(task.body, task.integrator, task.step, states[n], toes[n], force[n])
        )
    rolls = [("rollout", np.stack(states))]
    if told or task.integrator != "euler":
        smooth = continuous_rollout(task.body, task.step, found.state[begins], toes, force)
        rolls.append(("continuous", smooth))
    planned = found.state[np.concatenate([window, window[-1:] + 1])]
    for kind, rolled in rolls:
        off = np.abs(rolled - planned).max(axis=0)  # (B, 12)
        for name, part in (("velocity", VELOCITY), ("attitude", ANGLES)):
            check = worst(task, f"{kind}.{name}", off[:, part].max(axis=1))
            if kind == "continuous" and task.integrator == "euler":
                check = unjudged(check, "forward Euler", EULER, _AT_KNOTS[name])
            yield check


def _forces(task: WalkTask, found: WalkTrajectory) -> Iterator[Check]:
    force, contact = found.force, found.gait.contact
    size = np.linalg.norm(force, axis=-1)
    yield worst(task, "force.swing", np.where(contact, 0.0, size))
    # Cones stand on their regions, as steep as these are
    pressed, sideways = normal_and_sideways(task.ground, found.gait.region, force)
    room = task.ground.friction * pressed
    used = np.where(size > 1e-3, sideways / np.maximum(room, 1e-9), 0.0)
    # Below zero: the leg pulls at the ground.
    yield worst(task, "force.friction", np.maximum(sideways - room, -pressed), used)
    largest = np.abs(force).max(axis=-1)
    limit = task.body.force_limit
    yield worst(task, "force.limit", largest - limit, largest / limit)


def _joints(task: WalkTask, found: WalkTrajectory) -> Iterator[Check]:
    for residuals_of in (torque_residuals, speed_residuals):
        yield from (worst(task, *told) for told in residuals_of(task, found))


def _feet(task: WalkTask, found: WalkTrajectory, told: bool) -> Iterator[Check]:
    toes, contact, region = found.toes, found.gait.contact, found.gait.region
    stays = contact[:-1] & contact[1:]
    slip = np.where(stays, np.abs(np.diff(toes, axis=0)).max(axis=-1), 0.0)
    yield worst(task, "contact.no_slip", slip)
    since_start = np.logical_and.accumulate(contact, axis=0)
    off = off_region(task.ground, region, toes, since_start)
    yield worst(task, "contact.region", np.where(contact, off, 0.0))
    short = to_clear(task.ground, toes, contact) + task.lift - toes[..., 2]
    # Where the first toes are is given: what swings from the start is lifted from there on.
    swinging = ~contact
    swinging[0] = False
    yield worst(task, "swing.height", np.where(swinging, np.maximum(short, 0.0), 0.0))
    spots = toes_in_body(found.state, toes)
    if task.whole_stance or told:
        after = toes_in_body(found.state[1:], toes[:-1])
        over = (np.abs(after - task.body.toe_center) - task.body.toe_half).max(axis=-1)
        whole = worst(task, "workspace.whole_stance", np.where(contact[:-1], over, -1.0))
        if not task.whole_stance:
            whole = unjudged(whole, "task.whole_stance is not asked", KNOTS, _REACH)
        yield whole
    room = np.abs(spots - task.body.toe_center) - task.body.toe_half
    beyond = room.max(axis=-1)
    used = (1.0 + room / task.body.toe_half).max(axis=-1)
    counts = contact.copy()
    counts[1:] = True
    used = np.where(counts, used, 0.0)
    yield worst(task, "workspace.toe", np.where(counts, beyond, -1.0), used)


def worst(task: WalkTask, name: str, residuals: Array, used: Array | None = None) -> Check:
    """A check over knots (n,) or knots and legs (n, L); NaN anywhere counts as the worst."""
    values = np.where(np.isnan(residuals), np.inf, residuals)
    index = np.unravel_index(int(np.argmax(values)), values.shape)
    check = judge(name, float(values[index]))
    if check.passed and used is not None:
        index = np.unravel_index(int(np.argmax(used)), used.shape)
        check = replace(check, used=min(float(used[index]), 1.0))
    if check.residual <= 0 and used is None:
        return check
    place = f"{task.step * index[0]:.2f} s"
    if len(index) > 1:
        place = f"{place}, {task.body.leg_names[index[1]]}"
    return replace(check, worst_at=place)


def judge(name: str, residual: float) -> Check:
    """A check by its name in `LIMITS`; NaN never passes."""
    limit = (LIMITS | LEG_LIMITS | LOOP_LIMITS)[name]
    residual = float(residual) + 0.0
    if math.isnan(residual):
        residual = math.inf
    return Check(name, residual, limit.value, limit.unit, residual <= limit.value, "", "")
