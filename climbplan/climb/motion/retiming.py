"""Time a climb by the dynamics of its links: every segment as fast as joints and contacts allow.

Segments between keyframes rest for a sample at both ends. Over the fraction tau of the time
between, all that moves is at the fraction

    u = 10 tau^3 - 15 tau^4 + 6 tau^5

of its path, with neither velocity nor acceleration at the ends. Twice as fast, accelerations are
four times as large. At every sample there have to be contact forces that balance weight and
inertia (`mechanics.inertia`) within friction and torque limits (`motions.pace`). Segments with a
sample that has none take longer, as do those with joints that are too slow, or toes that land too
fast: impacts are not in the dynamics.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.motion.keyframes import PACKED, Keyframes
from climbplan.climb.motion.trajectory import (
    BOUND_TOLERANCE,
    JointMotion,
    MotionStates,
    TimedMotion,
    compute_joint_motion,
    compute_speed_durations,
    interpolate_states,
    split_samples,
)
from climbplan.climb.plan.climb_plan import Trajectory
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.climb.schema.model import MIN_PACED_RATE
from climbplan.errors import Unresolved
from climbplan.mechanics.equilibrium import grasp_matrix, link_torques
from climbplan.mechanics.flat_contact import moment_of
from climbplan.mechanics.inertia import CarriedMass, LinkInertiaLoad, compute_inertial_load
from climbplan.mechanics.stiffness import joint_softness
from climbplan.motions.pace import ForceProblem, build_pyramids
from climbplan.robots.kinematics import by_point, point_jacobian, pushed_points
from climbplan.robots.model import Robot

_MIN_SAMPLES = 10  # of a segment that moves
_NUM_RESTING = 2  # samples in addition, one at each end
_RESERVE = 0.75  # of the fastest pace
_LANDING_SPEED = 0.2  # [m/s] largest of landing toes; chosen so that they do not rebound in MuJoCo
_PEAK_SPEED = 1.875  # of a segment, over its mean: du/dtau at tau = 1/2
_MAX_ROUNDS = 20  # of longer segments
_LONGER, _LONGEST = 1.05, 2.0  # factor on durations that are too short, in one round
_TORQUE_MARGIN = 1e-6  # of torques that planned forces need beyond a limit
_MOMENT_WEIGHT = 1e-3  # of differences at corners of soles, in comparison with those of wrenches


class _SafetyFactors(NamedTuple):
    """Factors by which friction and torques are reduced, but not below what planned forces use."""

    friction: float
    torque: float


_SAFETY_FACTORS = (_SafetyFactors(1.5, 1.2), _SafetyFactors(1.0, 1.0))  # in the order of trials


@dataclass(frozen=True)
class _PacedSamples:
    """A motion at S samples of segments with given durations, with its planned static forces."""

    segment: IntArray  # (S,)
    states: MotionStates
    joints: JointMotion
    inertia: LinkInertiaLoad
    problem: ForceProblem


def retime_trajectory(scene: MotionScene, planned: TimedMotion) -> Trajectory:
    """Return the trajectory of a motion that is timed by its dynamics, at the spec's pace.

    Args:
        scene: The scene, whose spec states a pace, of a robot without grippers.
        planned: The quasi-static motion.

    Raises:
        Unresolved: There are no such forces, however slow the motion is.
        ReachFailure: A limb cannot follow.
    """
    *with_reserves, at_limits = _SAFETY_FACTORS
    for factors in with_reserves:
        with suppress(Unresolved):
            return _time_segments(scene, planned.frames, factors)
    return _time_segments(scene, planned.frames, at_limits)


def _time_segments(
    scene: MotionScene, frames: Keyframes, safety_factors: _SafetyFactors
) -> Trajectory:
    """Return the trajectory with segments as short as limits with safety factors allow."""
    rate = max(scene.spec.trajectory.rate, MIN_PACED_RATE)
    count = _NUM_RESTING + np.ceil(_compute_first_durations(scene, frames, rate) * rate)
    for _ in range(_MAX_ROUNDS):
        sampled = _sample_motion(scene, frames, count, safety_factors)
        factor = _compute_sample_factors(sampled)
        if not np.isfinite(factor).all():
            break
        trajectory = None
        if (factor <= 1).all():
            trajectory = _build_trajectory(scene, sampled, rate)
            planned = sampled.joints.command
            factor = _compute_joint_factors(scene.robot, trajectory.joint_command, planned, rate)
            if (factor <= 1).all():
                return trajectory
        count = _lengthen_segments(sampled, count, factor)
    sample = int(factor.argmax())
    raise Unresolved(
        f"{frames.label[sampled.segment[sample]]}: no contact forces within friction and torque "
        "limits move the links at any pace",
        because="contact forces that are planned to hold the robot are at their limits; "
        "force.safety_friction and force.safety_torque leave more of them",
        stage="trajectory",
    )


def _ease(fraction: Array) -> Array:
    """Return the fraction of the path after a fraction of the time of a segment."""
    return fraction**3 * (10.0 + fraction * (6.0 * fraction - 15.0))


def _compute_first_durations(scene: MotionScene, frames: Keyframes, rate: float) -> Array:
    """Return durations (F-1,) of segments by joint speeds and the spec's speed [s]."""
    spec = scene.spec.trajectory
    duration = np.maximum(compute_speed_durations(scene, frames, _ease), _MIN_SAMPLES / rate)
    duration = np.maximum(duration, _compute_landing_durations(frames))
    pace: float | Literal["fastest"] | None = spec.pace
    if pace is None or pace == "fastest":
        return duration
    travel = float(np.linalg.norm(np.diff(frames.com, axis=0), axis=1).sum())
    fraction = frames.duration_fraction / frames.duration_fraction.sum()
    return np.maximum(duration, fraction * travel / (pace * spec.speed))


def _compute_landing_durations(frames: Keyframes) -> Array:
    """Return durations (F-1,) of segments in which toes land at `_LANDING_SPEED` at most [s]."""
    lands = ~frames.contact & np.append(frames.contact[1:], frames.contact[-1:], axis=0)
    distance = np.linalg.norm(np.diff(frames.toes, axis=0), axis=-1)
    peak = _PEAK_SPEED * np.where(lands, distance, 0.0).max(axis=1)
    return np.asarray(peak / _LANDING_SPEED)


def _sample_motion(
    scene: MotionScene, frames: Keyframes, count: Array, safety_factors: _SafetyFactors
) -> _PacedSamples:
    """Return the motion whose segments have so many samples (F-1,)."""
    rate = max(scene.spec.trajectory.rate, MIN_PACED_RATE)
    segment, fraction = split_samples(count, rate)
    num_moving = count[segment] - _NUM_RESTING
    fraction = np.clip((fraction * count[segment] - _NUM_RESTING / 2) / num_moving, 0.0, 1.0)
    states = interpolate_states(frames, segment, _ease(fraction))
    joints = compute_joint_motion(scene, states, [frames.label[s] for s in segment])
    payload = scene.spec.task.payload
    inertia = compute_inertial_load(
        scene.robot,
        states.com,
        states.rpy,
        joints.angles,
        period=1 / rate,
        carried=CarriedMass(payload.mass, np.array(payload.offset, float)),
    )
    problem = _build_force_problem(scene, states, joints, inertia, safety_factors)
    return _PacedSamples(segment, states, joints, inertia, problem)


def _build_force_problem(
    scene: MotionScene,
    states: MotionStates,
    joints: JointMotion,
    inertia: LinkInertiaLoad,
    safety_factors: _SafetyFactors,
) -> ForceProblem:
    """Return balance and limits at S samples; planned forces balance all but inertia."""
    robot, weight, samples = scene.robot, scene.robot.weight, len(states.com)
    normal = states.normal / np.linalg.norm(states.normal, axis=-1, keepdims=True)
    planned_force, cost = _spread_planned_forces(robot, normal, states, joints)
    points = planned_force.shape[1]
    arms = pushed_points(robot, states.toes, normal) - states.com[:, None]
    torques = point_jacobian(robot, states.rpy, joints.angles, normal)  # (S, C, 3, J)
    torque_map = np.zeros((samples, *joints.angles.shape[1:], points, 3))
    for point in range(points):
        limb = point * robot.limb_count // points
        torque_map[:, limb, :, point] = np.swapaxes(torques[:, point], -1, -2)
    force_map = np.concatenate(
        [
            grasp_matrix(arms).reshape(samples, 6, points, 3),
            torque_map.reshape(samples, -1, points, 3),
        ],
        axis=1,
    )
    gravity = link_torques(robot, states.rpy, joints.angles)
    # At rest planned forces balance weight and all other loads
    wrench = -np.einsum("sica,sca->si", force_map[:, :6], planned_force)
    limit = np.maximum(
        robot.max_torque / safety_factors.torque, (1 + _TORQUE_MARGIN) * np.abs(joints.torque)
    )
    friction = np.array([surface.friction for surface in scene.terrain.surfaces])
    pyramids = build_pyramids(
        by_point(robot, normal, 1),
        by_point(robot, friction[states.region], 1),
        planned_force if robot.sole is None else np.zeros_like(planned_force),
        safety_factors.friction,
    )
    return ForceProblem(
        static_load=np.concatenate([wrench, gravity.reshape(samples, -1)], axis=1) / weight,
        inertial_load=np.concatenate([inertia.wrench, inertia.torque.reshape(samples, -1)], axis=1)
        / weight,
        force_map=force_map,
        torque_limit=limit.reshape(samples, -1) / weight,
        cones=pyramids,
        is_touching=by_point(robot, states.contact, 1),
        weight=weight,
        max_pace=1.0,
        planned_force=planned_force / weight,
        cost=cost,
    )


def _spread_planned_forces(
    robot: Robot, normal: Array, states: MotionStates, joints: JointMotion
) -> tuple[Array, Array | None]:
    """Return planned forces (S, C, 3) at the points of feet [N], and their cost if feet are flat.

    At the corners of a sole, forces of least squares have the planned force and moment. Only
    differences of force and moment have a cost there: corners share them in several ways.
    """
    contact = states.contact[..., None]
    force = np.where(contact, joints.force, 0.0)
    if robot.sole is None:
        return force, None
    moment = np.where(contact, joints.contact_state[..., PACKED:], 0.0)
    scale = 1 / float(robot.sole.half_size.mean())
    grasp = grasp_matrix(robot.sole.arms(normal))  # (S, N, 6, 12)
    corners = np.linalg.pinv(grasp) @ np.concatenate([force, moment], axis=-1)[..., None]
    grasp = grasp * np.array([1.0] * 3 + [scale] * 3)[:, None]
    samples, limbs = force.shape[:2]
    count = grasp.shape[-1]
    hessian = np.swapaxes(grasp, -1, -2) @ grasp + _MOMENT_WEIGHT * np.eye(count)
    cost = np.zeros((samples, limbs, count, limbs, count))
    for limb in range(limbs):
        cost[:, limb, :, limb] = hessian[:, limb]
    points = limbs * count // 3
    return (
        np.asarray(corners[..., 0].reshape(samples, points, 3)),
        cost.reshape(samples, points, 3, points, 3),
    )


def _compute_sample_factors(sampled: _PacedSamples) -> Array:
    """Return how much longer the segments of samples (S,) have to take, 1 at most if not at all.

    Infinite where there are no forces at rest.
    """
    problem, fastest = sampled.problem, 1 / _RESERVE
    is_moving = np.abs(problem.inertial_load).max(axis=1) > 0
    factor = np.ones(len(sampled.segment))
    for sample in range(len(factor)):
        if is_moving[sample]:
            pace = problem.find_sample_pace(sample, fastest)
            factor[sample] = np.inf if pace == 0 else fastest / pace
        elif problem.solve(sample, 1.0) is None:
            factor[sample] = np.inf
    return factor


def _compute_joint_factors(robot: Robot, command: Array, planned: Array, rate: float) -> Array:
    """Return how much longer the segments of samples (S,) have to take by joint limits.

    Commands (S, N, J) differ from planned ones, which are within their bounds, by inertia. This
    difference falls with the square of a duration.
    """
    speed = np.abs(np.diff(command, axis=0, append=command[-1:])) * rate / robot.max_joint_speed
    factor = speed.max(axis=(1, 2))
    for sign, bound in ((1.0, robot.joint_upper), (-1.0, robot.joint_lower)):
        is_outside = sign * (command - bound) > BOUND_TOLERANCE
        slack = np.maximum(sign * (bound - planned), BOUND_TOLERANCE)
        ratio = np.sqrt(np.maximum(sign * (command - planned), 0.0) / slack)
        longer = np.where(is_outside, np.clip(ratio, _LONGER, _LONGEST), 0.0)
        factor = np.maximum(factor, longer.max(axis=(1, 2)))
    return factor


def _lengthen_segments(sampled: _PacedSamples, count: Array, factor: Array) -> Array:
    """Return numbers of samples (F-1,) of segments, longer by the factors of their samples (S,)."""
    longest = np.ones(len(count))
    slow = factor > 1
    np.maximum.at(longest, sampled.segment[slow], factor[slow])
    longest[longest > 1] = np.maximum(longest[longest > 1], _LONGER)
    return np.ceil(longest * (count - _NUM_RESTING)) + _NUM_RESTING


def _build_trajectory(scene: MotionScene, sampled: _PacedSamples, rate: float) -> Trajectory:
    """Return the trajectory with forces that move the links, whose samples all have some."""
    robot, problem, states, joints = scene.robot, sampled.problem, sampled.states, sampled.joints
    assert problem.planned_force is not None
    solutions = (problem.solve(sample, 1.0) for sample in range(len(sampled.segment)))
    force = np.array([solution for solution in solutions if solution is not None])
    contact_torque, planned_torque = (
        problem.weight
        * np.einsum("sica,sca->si", problem.force_map[:, 6:], f).reshape(joints.angles.shape)
        for f in (force, problem.planned_force)
    )
    command = joints.command - joint_softness(robot) * (contact_torque - planned_torque)
    gravity = link_torques(robot, states.rpy, joints.angles)
    force = problem.weight * force
    moment = None
    if robot.sole is not None:
        force = force.reshape(len(force), robot.limb_count, -1, 3)
        moment = moment_of(robot.sole, states.normal, force)
        force = force.sum(axis=2)
    return Trajectory(
        np.arange(len(command)) / rate,
        states.com,
        states.rpy,
        command,
        states.contact,
        force=force,
        moment=moment,
        torque=contact_torque + gravity + sampled.inertia.torque,
    )
