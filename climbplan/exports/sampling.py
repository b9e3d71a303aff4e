"""A motion at other times than those of its plan: at a rate, and with load ramps at its ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.exports.motion import (
    BodyMotion,
    ContactMotion,
    ExportedJoints,
    RobotMotion,
    require_increasing,
    unwrap_quaternions,
)

_MOST_RATE = 2000.0  # [Hz]
_MOST_SAMPLES = 2_000_000
_SAME = 1e-9  # [s] within which two times are one
_LONGEST_RAMP = 60.0  # [s]
RAMP_WORDS = (
    "the first and the last {seconds:g} s are load ramps: hold the robot, or let it stand by "
    "itself, until contacts have taken load and from when they give it up"
)


def resample_at_rate(motion: RobotMotion, rate: float) -> RobotMotion:
    """Return the motion at `rate` [Hz], on the cubic splines through its samples.

    A motion with a sampler of its own (a walk's) is what that one says, with more samples where
    forces change between two.  What the plan has a sample
    of is kept exactly. Contacts are those of the sample before. Raises UsageError for rates that
    cannot be.
    """
    require_increasing(motion.time)
    time = _build_times(motion, rate)
    if motion.sampler is not None:
        return motion.sampler(_add_force_changes(motion, time))
    before = np.searchsorted(motion.time, time, side="right") - 1
    return replace(
        motion,
        time=time,
        bodies=tuple(_sample_body(motion.time, body, time) for body in motion.bodies),
        base=None if motion.base is None else _sample_body(motion.time, motion.base, time),
        joints=None if motion.joints is None else _sample_joints(motion.time, motion.joints, time),
        contacts=None if motion.contacts is None else _sample_contacts(motion, before, time),
        latches=None
        if motion.latches is None
        else replace(
            motion.latches,
            anchor=motion.latches.anchor[before],
            anchor_position=_interpolate_linearly(
                motion.time, motion.latches.anchor_position, time
            ),
        ),
        limbs=tuple(
            replace(limb, points=_interpolate_spline(motion.time, limb.points, time))
            for limb in motion.limbs
        ),
    )


def _build_times(motion: RobotMotion, rate: float) -> Array:
    """Return (M,) of samples at a rate; the plan's own where they are as good as the same."""
    if not 0 < rate <= _MOST_RATE:
        raise UsageError(f"--rate {rate:g}: expected more than 0 and at most {_MOST_RATE:g} Hz")
    begin, end = float(motion.time[0]), float(motion.time[-1])
    count = int(np.floor((end - begin) * rate * (1 + 1e-12))) + 1
    if count > _MOST_SAMPLES:
        raise UsageError(f"--rate {rate:g}: {count} samples, expected at most {_MOST_SAMPLES}")
    time = begin + np.arange(count) / rate
    if end - time[-1] > 1e-9:
        time = np.append(time, end)  # the plan's last sample ends it
    nearest_sample = np.clip(np.searchsorted(motion.time, time), 1, max(len(motion.time) - 1, 1))
    if len(motion.time) > 1:
        for side in (nearest_sample - 1, nearest_sample):
            time = np.where(np.abs(motion.time[side] - time) < 1e-9, motion.time[side], time)
    return np.asarray(time)


def _add_force_changes(motion: RobotMotion, time: Array) -> Array:
    """Return times and those at which forces change, unless samples come less often than that."""
    changes = motion.changes
    if changes is None or len(time) < 2 or time[1] - time[0] > np.diff(changes).min() + _SAME:
        return time
    after = np.clip(np.searchsorted(time, changes), 1, len(time) - 1)
    distance = np.minimum(np.abs(time[after] - changes), np.abs(time[after - 1] - changes))
    return np.sort(np.concatenate([time, changes[distance > _SAME]]))


def _sample_body(time: Array, body: BodyMotion, new_time: Array) -> BodyMotion:
    return BodyMotion(
        body.name,
        _interpolate_spline(time, body.position, new_time),
        unwrap_quaternions(Slerp(time, Rotation.from_quat(body.quaternion))(new_time).as_quat()),
    )


def _interpolate_spline(time: Array, values: Array, new_time: Array, order: int = 0) -> Array:
    if len(time) < 3 and order > 0:
        return np.zeros((len(new_time), *values.shape[1:]))
    if len(time) < 3:
        flat = [np.interp(new_time, time, column) for column in values.reshape(len(time), -1).T]
        return np.stack(flat, axis=1).reshape(len(new_time), *values.shape[1:])
    samples = CubicSpline(time, values, axis=0, bc_type="clamped")(new_time, order)
    if order == 0:  # the plan's own samples to the last bit
        sample_index = np.minimum(np.searchsorted(time, new_time), len(time) - 1)
        is_sample = time[sample_index] == new_time
        samples[is_sample] = values[sample_index[is_sample]]
    return np.asarray(samples)


def _sample_joints(time: Array, joints: ExportedJoints, new_time: Array) -> ExportedJoints:
    return replace(
        joints,
        command=_interpolate_spline(time, joints.command, new_time),
        velocity=_interpolate_spline(time, joints.command, new_time, 1),
        acceleration=_interpolate_spline(time, joints.command, new_time, 2),
        angle=_interpolate_spline(time, joints.angle, new_time),
        torque=_interpolate_linearly(time, joints.torque, new_time),
        feedforward=_interpolate_linearly(time, joints.feedforward, new_time),
        gravity=_interpolate_linearly(time, joints.gravity, new_time),
        link_angle=None
        if joints.link_angle is None
        else _interpolate_spline(time, joints.link_angle, new_time),
    )


def _interpolate_linearly(time: Array, values: Array, new_time: Array) -> Array:
    """Interpolate torques and forces linearly: a spline would overshoot where contacts change."""
    before = np.clip(np.searchsorted(time, new_time, side="right") - 1, 0, max(len(time) - 2, 0))
    after = np.minimum(before + 1, len(time) - 1)
    span = np.where(after > before, time[after] - time[before], 1.0)
    fraction = np.clip((new_time - time[before]) / span, 0.0, 1.0)
    fraction = fraction.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - fraction) * values[before] + fraction * values[after])


def _sample_contacts(motion: RobotMotion, before: IntArray, new_time: Array) -> ContactMotion:
    contacts = motion.contacts
    assert contacts is not None
    touching = contacts.touching[before]
    force = _interpolate_linearly(motion.time, contacts.force, new_time)
    return replace(
        contacts,
        point=_interpolate_linearly(motion.time, contacts.point, new_time),
        force=np.where(touching[..., None], force, 0.0),
        touching=touching,
    )


def add_load_ramps(motion: RobotMotion, seconds: float) -> RobotMotion:
    """Return the motion with a load ramp before it and one after it.

    Bodies and toes stand still meanwhile. At first no contact is loaded and commands are the angles
    of the links; torques, forces and what they bend grow to those of the first sample. The same
    backwards at the end. The weight of links is held all the time, that of the robot is not.

    Args:
        motion: What is told a controller, at the rate at which it is told.
        seconds: Length of either ramp [s].

    Raises:
        UsageError: The length is out of range, or nothing in the motion is loaded.
    """
    if not 0 < seconds <= _LONGEST_RAMP:
        raise UsageError(
            f"--ramp {seconds:g}: expected more than 0 and at most {_LONGEST_RAMP:g} s"
        )
    joints = motion.joints
    if joints is None or joints.limits is None or motion.sampler is not None:
        raise UsageError(
            f"--ramp: expected a climb, which begins and ends under load; {motion.name} is none"
        )
    span = float(motion.time[-1] - motion.time[0])
    count = int(np.ceil(seconds * (len(motion.time) - 1) / span)) if span > 0 else 1
    count = min(max(count, 2), _MOST_SAMPLES)
    ramp_fraction = np.arange(count) / count  # of the ramp that has passed, before the first sample
    size = len(motion.time)
    index = np.concatenate([np.zeros(count, int), np.arange(size), np.full(count, size - 1)])
    load = np.concatenate([ramp_fraction, np.ones(size), ramp_fraction[::-1]])
    begin, end = motion.time[0], motion.time[-1]
    time = np.concatenate(
        [
            begin + seconds * ramp_fraction,
            motion.time + seconds,
            end + seconds * (2.0 - ramp_fraction[::-1]),
        ]
    )
    side = np.repeat([1.0, 0.0, -1.0], [count, size, count]) / seconds
    return replace(
        motion,
        time=time,
        ramp=seconds,
        bodies=tuple(_select_samples(body, index) for body in motion.bodies),
        base=None if motion.base is None else _select_samples(motion.base, index),
        joints=_scale_load(joints, index, load, side),
        contacts=None
        if motion.contacts is None
        else replace(
            motion.contacts,
            point=motion.contacts.point[index],
            force=motion.contacts.force[index] * smooth_step(load)[0][:, None, None],
            touching=motion.contacts.touching[index],
        ),
        limbs=tuple(replace(limb, points=limb.points[index]) for limb in motion.limbs),
        words=(*motion.words, RAMP_WORDS.format(seconds=seconds)),
    )


def smooth_step(fraction: Array) -> tuple[Array, Array, Array]:
    """Return a step from 0 to 1 over `share`, at rest at both ends, with two derivatives by it."""
    return (
        fraction**3 * (10 - 15 * fraction + 6 * fraction**2),
        30 * fraction**2 * (1 - fraction) ** 2,
        60 * fraction * (1 - fraction) * (1 - 2 * fraction),
    )


def _select_samples(body: BodyMotion, index: IntArray) -> BodyMotion:
    return BodyMotion(body.name, body.position[index], body.quaternion[index])


def _scale_load(
    joints: ExportedJoints, index: IntArray, load: Array, rate: Array
) -> ExportedJoints:
    """Return joints whose part by loads is what `load` (M,) says, which changes by `rate` (M,)
    [1/s].
    """
    load_fraction, speed, curvature = (values[:, None] for values in smooth_step(load))
    link_angle = joints.angle if joints.link_angle is None else joints.link_angle
    unloaded_angle = link_angle[index]
    deflection = joints.command[index] - unloaded_angle
    ramped = (rate != 0)[:, None]
    return replace(
        joints,
        command=np.where(
            ramped, unloaded_angle + load_fraction * deflection, joints.command[index]
        ),
        velocity=np.where(ramped, speed * rate[:, None] * deflection, joints.velocity[index]),
        acceleration=np.where(
            ramped, curvature * rate[:, None] ** 2 * deflection, joints.acceleration[index]
        ),
        angle=np.where(
            ramped,
            unloaded_angle + load_fraction * (joints.angle[index] - unloaded_angle),
            joints.angle[index],
        ),
        torque=load_fraction * joints.torque[index],
        feedforward=load_fraction * joints.feedforward[index],
        gravity=joints.gravity[index],
        link_angle=unloaded_angle,
    )
