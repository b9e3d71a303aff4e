"""Checks of the motion against the instants that it has to pass (samples as in `motion_state`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.capsules import build_capsules
from climbplan.climb.check.anew.kinematics import (
    build_limbs,
    compute_body_axes,
)
from climbplan.climb.check.anew.soles import build_sole_axes
from climbplan.climb.check.clearance import (
    judge_capsules,
    judge_link_depths,
    measure_link_depths,
)
from climbplan.climb.check.feet import judge_feet, judge_soles
from climbplan.climb.check.motion_state import MotionState, reconstruct_motion
from climbplan.climb.check.pressing import check_pressing
from climbplan.climb.check.self_collision import judge_self_collision
from climbplan.climb.check.statics import mark_linear_model
from climbplan.climb.check.subject import Subject
from climbplan.robots.joint_units import format_bound_margin
from climbplan.verification.check import Check, judge, judge_worst

_MAX_STRIDE = 5e-3  # [m] a swinging toe is looked at this often
_MAX_PIECES = 16


def check_trajectory(subject: Subject) -> Iterator[Check]:
    """Yield checks of rate, gait, body path, commands, joint bounds and speeds, and clearance."""
    yield _check_rate(subject)
    yield _check_ends(subject)
    motion = reconstruct_motion(subject)
    yield _check_sequence(motion)
    yield _check_body(motion)
    for check in check_pressing(motion):
        yield mark_linear_model(check) if subject.predicts_deflection else check
    yield _check_instants(motion)
    yield from _check_joints(motion)
    yield from _check_clearance(motion)


def _check_rate(subject: Subject) -> Check:
    """Check that samples are evenly spaced in time."""
    time = subject.plan.trajectory.time
    step = np.diff(time)
    rate_error = np.abs(step - (time[-1] - time[0]) / (len(time) - 1))
    rate_error = np.where(step > 0, rate_error, np.inf)
    return judge_worst("trajectory.rate", rate_error, lambda s: subject.describe_time(s))


def _check_ends(subject: Subject) -> Check:
    """Check that the motion begins at the start and ends at the last posture."""
    rounds, trajectory = subject.plan.rounds, subject.plan.trajectory
    end_error = np.vstack(
        [
            trajectory.com[[0, -1]] - rounds.com[[0, -1]],
            trajectory.rpy[[0, -1]] - rounds.rpy[[0, -1]],
        ]
    )
    names = ("start, position", "end, position", "start, rotation", "end, rotation")
    return judge_worst(
        "trajectory.endpoints", np.abs(end_error).max(axis=1), lambda row: names[row]
    )


def _check_sequence(motion: MotionState) -> Check:
    """Check that limbs lift together as in the instants, and that steps come in order."""
    lifted, moving_limbs = motion.lifted, motion.gait.moving_limbs
    is_swinging: BoolArray = np.asarray(lifted.any(axis=1))
    starts = np.flatnonzero(is_swinging & ~np.append(False, is_swinging[:-1]))
    overfull_samples = np.flatnonzero(lifted.sum(axis=1) > moving_limbs.sum(axis=1).max())
    if len(overfull_samples):
        sample = int(overfull_samples[0])
        place = f"{motion.describe_sample(sample)}: {lifted[sample].sum()} limbs lifted at once"
        return judge("trajectory.sequence", float(len(overfull_samples)), place)
    if is_swinging[-1]:
        return judge("trajectory.sequence", 1.0, "the motion ends with a limb lifted")
    step = np.cumsum(np.isin(np.arange(len(lifted)), starts)) - 1
    planned = moving_limbs[np.clip(step, 0, len(moving_limbs) - 1)] & is_swinging[:, None]
    mismatches = np.argwhere(lifted != planned)
    if len(mismatches):
        sample, limb = (int(i) for i in mismatches[0])
        name = motion.subject.name_limb(limb)
        out_of_turn = "lifts" if lifted[sample, limb] else "stays down"
        place = f"{motion.subject.describe_time(sample)}: {name} {out_of_turn} out of turn"
        return judge("trajectory.sequence", float(len(mismatches)), place)
    missing = abs(len(starts) - len(moving_limbs))
    return judge(
        "trajectory.sequence",
        float(missing),
        f"{len(starts)} steps, expected {len(moving_limbs)}" if missing else "",
    )


def _check_body(motion: MotionState) -> Check:
    """Check that the body waits while limbs are in the air, then moves straight to its next
    station.
    """
    plan = motion.subject.plan
    stations = np.hstack([motion.gait.station_com, motion.gait.station_rpy])
    first = np.hstack([plan.rounds.com[:1], plan.rounds.rpy[:1]])  # from where it starts out
    before = np.vstack([first, stations[:-1]])
    end = stations[motion.steps_done]
    is_waiting: BoolArray = np.asarray(motion.lifted.any(axis=1))
    start = np.where(is_waiting[:, None], end, before[motion.steps_done])
    pose = np.hstack([plan.trajectory.com, plan.trajectory.rpy])
    path_error = _measure_segment_distance(pose, start, end)  # one radian counts as one metre
    return judge_worst("trajectory.body", path_error, motion.describe_sample)


def _check_instants(motion: MotionState) -> Check:
    """Check that some sample is close to each instant in body pose and commands of loaded limbs."""
    plan = motion.subject.plan
    instants, trajectory = plan.instants, plan.trajectory
    k = 2 * motion.steps_done - np.where(motion.lifted.any(axis=1), 0, 1)
    instant_error = np.full(instants.count, np.inf)
    samples = np.flatnonzero((k >= 0) & (k < instants.count))
    k = k[samples]
    command = np.abs(trajectory.joint_command[samples] - plan.forces.joint_command[k])
    command_error = np.where(instants.contact[k], command.max(axis=-1), 0.0).max(axis=1)
    body_error = np.linalg.norm(trajectory.com[samples] - instants.com[k], axis=-1)
    rotation_error = np.abs(trajectory.rpy[samples] - instants.rpy[k]).max(axis=-1)
    np.minimum.at(
        instant_error, k, np.maximum(np.maximum(command_error, body_error), rotation_error)
    )
    return judge_worst("trajectory.instants", instant_error, motion.subject.describe_instant)


def _check_joints(motion: MotionState) -> Iterator[Check]:
    """Check bounds of commanded and standing joint angles, speeds, and reach of standing limbs."""
    plan = motion.subject.plan
    robot, command = plan.robot, plan.trajectory.joint_command
    standing_angles = np.where(motion.lifted[..., None], command, motion.standing.angles)
    bound_violation = np.full(command.shape, -np.inf)
    for angles in (command, standing_angles):
        bound_violation = np.maximum(
            bound_violation, np.maximum(robot.joint_lower - angles, angles - robot.joint_upper)
        )
    margin = format_bound_margin(robot, bound_violation)
    half_range = (robot.joint_upper - robot.joint_lower) / 2
    yield judge_worst(
        "trajectory.joint_bounds",
        bound_violation,
        motion.describe_sample,
        margin,
        used=1 + bound_violation / half_range,
    )

    step = np.diff(plan.trajectory.time)[:, None, None]
    speed = np.abs(np.diff(command, axis=0)) / step
    speed_ratio = speed / robot.max_joint_speed
    margin = f"{100 * speed_ratio.max():.0f} % of the limit"
    excess = speed - robot.max_joint_speed
    yield judge_worst("speed.limit", excess, motion.describe_sample, margin, speed_ratio)
    missing = np.where(motion.lifted, 0.0, motion.standing.missing)
    yield judge_worst("trajectory.reach", missing, motion.describe_sample)


def _check_clearance(motion: MotionState) -> Iterator[Check]:
    """Check that links of standing and swinging limbs stay out of solids, between samples too."""
    points = np.where(
        motion.lifted[..., None, None], motion.commanded.points, motion.standing.points
    )
    trajectory = motion.subject.plan.trajectory
    angles = np.where(motion.lifted[..., None], trajectory.joint_command, motion.standing.angles)
    steps = [_SampledPoses(trajectory.com, compute_body_axes(trajectory.rpy), angles, points)]
    # A toe that swings far between two samples: joints turn evenly from one to the other.
    is_swinging = (motion.lifted[1:] & motion.lifted[:-1]).any(axis=1)
    strides = np.linalg.norm(np.diff(motion.commanded.toe, axis=0), axis=-1).max(axis=1)
    coarse_samples = np.flatnonzero(is_swinging & (strides > _MAX_STRIDE))
    pieces = int(min(np.ceil(strides[coarse_samples].max(initial=0.0) / _MAX_STRIDE), _MAX_PIECES))
    for piece in range(1, pieces):
        steps.append(_interpolate_poses(motion, steps[0], coarse_samples, piece / pieces))
    rows = np.concatenate([np.arange(len(points)), *[coarse_samples] * (len(steps) - 1)])
    poses = _SampledPoses(
        *(
            np.concatenate([vars(step)[pose_field.name] for step in steps])
            for pose_field in fields(_SampledPoses)
        )
    )
    joint_points = poses.points
    capsules = tuple(build_capsules(motion.subject.plan.robot, **vars(poses)))
    depth = measure_link_depths(motion.subject, joint_points, 0.0)
    max_depth = float(depth.max(initial=-np.inf))
    margin = f"{1e3 * max_depth:.1f} mm deep" if max_depth > 1e-6 else "no link inside a solid"

    def describe_pose(row: int) -> str:
        return motion.describe_sample(int(rows[row]))

    yield judge_link_depths(
        "trajectory.axis_collision", motion.subject, depth, describe_pose, margin
    )
    yield judge_capsules("trajectory.collision", motion.subject, capsules, describe_pose)
    yield judge_self_collision(
        "trajectory.self_collision", motion.subject, capsules, poses.com, poses.axes, describe_pose
    )
    toes, robot = joint_points[..., -1, :], motion.subject.plan.robot
    if robot.sole is None:
        yield from judge_feet("trajectory.feet", motion.subject, toes, describe_pose)
    else:
        soles = build_sole_axes(robot, poses.axes, poses.angles)
        yield from judge_soles("trajectory.feet", motion.subject, toes, soles, describe_pose)
    if motion.subject.plan.terrain.scan is not None:
        from climbplan.climb.check.scan_links import build_contacts, judge_scan_links

        contacts = build_contacts(
            motion.subject, motion.foothold_round, motion.next_round
        ).select_poses(rows)
        yield judge_scan_links("scan.trajectory", motion.subject, capsules, contacts, describe_pose)


@dataclass(frozen=True)
class _SampledPoses:
    """Body and limbs at P moments."""

    com: Array  # (P, 3) [m]
    axes: Array  # (P, 3, 3) of the body, as rows
    angles: Array  # (P, N, J) [rad]
    points: Array  # (P, N, J + 1, 3) joints and toes [m]


def _interpolate_poses(
    motion: MotionState, poses: _SampledPoses, samples: IntArray, fraction: float
) -> _SampledPoses:
    """Return limbs a fraction of the way to the next of S samples; standing ones stay in place."""
    trajectory = motion.subject.plan.trajectory

    def interpolate(values: Array) -> Array:
        return (1 - fraction) * values[samples] + fraction * values[samples + 1]

    com, axes = interpolate(trajectory.com), compute_body_axes(interpolate(trajectory.rpy))
    angles = interpolate(trajectory.joint_command)
    limbs = build_limbs(motion.subject.plan.robot, com, axes, angles)
    is_swinging = motion.lifted[samples] & motion.lifted[samples + 1]
    return _SampledPoses(
        com,
        axes,
        np.where(is_swinging[..., None], angles, poses.angles[samples]),
        np.where(is_swinging[..., None, None], limbs.points, poses.points[samples]),
    )


def _measure_segment_distance(points: Array, starts: Array, ends: Array) -> Array:
    """Return distances (...) of points (..., D) from segments."""
    segment = ends - starts
    square = (segment**2).sum(axis=-1)
    fraction = ((points - starts) * segment).sum(axis=-1)
    fraction = np.clip(
        np.divide(fraction, square, out=np.zeros_like(fraction), where=square > 0), 0, 1
    )
    distance: Array = np.linalg.norm(points - starts - fraction[..., None] * segment, axis=-1)
    return distance
