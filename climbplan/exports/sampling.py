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
    JointMotion,
    RobotMotion,
    continuous_quaternions,
    require_increasing,
)

_MOST_RATE = 2000.0  # [Hz]
_MOST_SAMPLES = 2_000_000
_SAME = 1e-9  # [s] within which two times are one
_LONGEST_RAMP = 60.0  # [s]
RAMP_WORDS = (
    "the first and the last {seconds:g} s are load ramps: hold the robot, or let it stand by "
    "itself, until contacts have taken load and from when they give it up"
)


def at_rate(motion: RobotMotion, rate: float) -> RobotMotion:
    """The motion at `rate` [Hz], on the cubic splines through its samples.

    A motion with a sampler of its own (a walk's) is what that one says, with more samples where
    forces change between two.  What the plan has a sample
    of is kept exactly. Contacts are those of the sample before. Raises UsageError for rates that
    cannot be.
    """
    require_increasing(motion.time)
    time = _times(motion, rate)
    if motion.sampler is not None:
        return motion.sampler(_with_changes(motion, time))
    before = np.searchsorted(motion.time, time, side="right") - 1
    return replace(
        motion,
        time=time,
        bodies=tuple(_body_at(motion.time, body, time) for body in motion.bodies),
        base=None if motion.base is None else _body_at(motion.time, motion.base, time),
        joints=None if motion.joints is None else _joints_at(motion.time, motion.joints, time),
        contacts=None if motion.contacts is None else _contacts_at(motion, before, time),
        latches=None
        if motion.latches is None
        else replace(
            motion.latches,
            anchor=motion.latches.anchor[before],
            anchor_position=_linear(motion.time, motion.latches.anchor_position, time),
        ),
        limbs=tuple(
            replace(limb, points=_smooth(motion.time, limb.points, time)) for limb in motion.limbs
        ),
    )


def _times(motion: RobotMotion, rate: float) -> Array:
    """(M,) of samples at a rate; the plan's own where they are as good as the same."""
    if not 0 < rate <= _MOST_RATE:
        raise UsageError(f"--rate {rate:g}: expected more than 0 and at most {_MOST_RATE:g} Hz")
    begin, end = float(motion.time[0]), float(motion.time[-1])
    count = int(np.floor((end - begin) * rate * (1 + 1e-12))) + 1
    if count > _MOST_SAMPLES:
        raise UsageError(f"--rate {rate:g}: {count} samples, at most {_MOST_SAMPLES}")
    time = begin + np.arange(count) / rate
    if end - time[-1] > 1e-9:
        time = np.append(time, end)  # the plan's last sample ends it
    near = np.clip(np.searchsorted(motion.time, time), 1, max(len(motion.time) - 1, 1))
    if len(motion.time) > 1:
        for side in (near - 1, near):
            time = np.where(np.abs(motion.time[side] - time) < 1e-9, motion.time[side], time)
    return np.asarray(time)


def _with_changes(motion: RobotMotion, time: Array) -> Array:
    """Times and those at which forces change, unless samples come less often than that."""
    changes = motion.changes
    if changes is None or len(time) < 2 or time[1] - time[0] > np.diff(changes).min() + _SAME:
        return time
    after = np.clip(np.searchsorted(time, changes), 1, len(time) - 1)
    near = np.minimum(np.abs(time[after] - changes), np.abs(time[after - 1] - changes))
    return np.sort(np.concatenate([time, changes[near > _SAME]]))


def _body_at(time: Array, body: BodyMotion, wanted: Array) -> BodyMotion:
    return BodyMotion(
        body.name,
        _smooth(time, body.position, wanted),
        continuous_quaternions(Slerp(time, Rotation.from_quat(body.quaternion))(wanted).as_quat()),
    )


def _smooth(time: Array, values: Array, wanted: Array, order: int = 0) -> Array:
    if len(time) < 3 and order > 0:
        return np.zeros((len(wanted), *values.shape[1:]))
    if len(time) < 3:
        flat = [np.interp(wanted, time, column) for column in values.reshape(len(time), -1).T]
        return np.stack(flat, axis=1).reshape(len(wanted), *values.shape[1:])
    found = CubicSpline(time, values, axis=0, bc_type="clamped")(wanted, order)
    if order == 0:  # the plan's own samples to the last bit
        own = np.minimum(np.searchsorted(time, wanted), len(time) - 1)
        same = time[own] == wanted
        found[same] = values[own[same]]
    return np.asarray(found)


def _joints_at(time: Array, joints: JointMotion, wanted: Array) -> JointMotion:
    return replace(
        joints,
        command=_smooth(time, joints.command, wanted),
        velocity=_smooth(time, joints.command, wanted, 1),
        acceleration=_smooth(time, joints.command, wanted, 2),
        angle=_smooth(time, joints.angle, wanted),
        torque=_linear(time, joints.torque, wanted),
        feedforward=_linear(time, joints.feedforward, wanted),
        gravity=_linear(time, joints.gravity, wanted),
        link_angle=None if joints.link_angle is None else _smooth(time, joints.link_angle, wanted),
    )


def _linear(time: Array, values: Array, wanted: Array) -> Array:
    """Torques and forces begin and end within a sample: a spline would swing about them."""
    at = np.clip(np.searchsorted(time, wanted, side="right") - 1, 0, max(len(time) - 2, 0))
    after = np.minimum(at + 1, len(time) - 1)
    span = np.where(after > at, time[after] - time[at], 1.0)
    share = np.clip((wanted - time[at]) / span, 0.0, 1.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - share) * values[at] + share * values[after])


def _contacts_at(motion: RobotMotion, before: IntArray, wanted: Array) -> ContactMotion:
    contacts = motion.contacts
    assert contacts is not None
    touching = contacts.touching[before]
    force = _linear(motion.time, contacts.force, wanted)
    return replace(
        contacts,
        point=_linear(motion.time, contacts.point, wanted),
        force=np.where(touching[..., None], force, 0.0),
        touching=touching,
    )


def with_ramps(motion: RobotMotion, seconds: float) -> RobotMotion:
    """The motion with a load ramp before it and one after it.

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
        raise UsageError(f"--ramp: climbs begin and end pressed, {motion.name} does not")
    span = float(motion.time[-1] - motion.time[0])
    count = int(np.ceil(seconds * (len(motion.time) - 1) / span)) if span > 0 else 1
    count = min(max(count, 2), _MOST_SAMPLES)
    share = np.arange(count) / count  # of the ramp that has passed, before the first sample
    size = len(motion.time)
    index = np.concatenate([np.zeros(count, int), np.arange(size), np.full(count, size - 1)])
    load = np.concatenate([share, np.ones(size), share[::-1]])
    begin, end = motion.time[0], motion.time[-1]
    time = np.concatenate(
        [
            begin + seconds * share,
            motion.time + seconds,
            end + seconds * (2.0 - share[::-1]),
        ]
    )
    side = np.repeat([1.0, 0.0, -1.0], [count, size, count]) / seconds
    return replace(
        motion,
        time=time,
        ramp=seconds,
        bodies=tuple(_picked(body, index) for body in motion.bodies),
        base=None if motion.base is None else _picked(motion.base, index),
        joints=_loaded(joints, index, load, side),
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


def smooth_step(share: Array) -> tuple[Array, Array, Array]:
    """Return a step from 0 to 1 over `share`, at rest at both ends, with two derivatives by it."""
    return (
        share**3 * (10 - 15 * share + 6 * share**2),
        30 * share**2 * (1 - share) ** 2,
        60 * share * (1 - share) * (1 - 2 * share),
    )


def _picked(body: BodyMotion, index: IntArray) -> BodyMotion:
    return BodyMotion(body.name, body.position[index], body.quaternion[index])


def _loaded(joints: JointMotion, index: IntArray, load: Array, rate: Array) -> JointMotion:
    """Joints whose part by loads is what `load` (M,) says, which changes by `rate` (M,) [1/s]."""
    part, speed, more = (values[:, None] for values in smooth_step(load))
    link_angle = joints.angle if joints.link_angle is None else joints.link_angle
    rest = link_angle[index]
    bent = joints.command[index] - rest
    ramped = (rate != 0)[:, None]
    return replace(
        joints,
        command=np.where(ramped, rest + part * bent, joints.command[index]),
        velocity=np.where(ramped, speed * rate[:, None] * bent, joints.velocity[index]),
        acceleration=np.where(ramped, more * rate[:, None] ** 2 * bent, joints.acceleration[index]),
        angle=np.where(ramped, rest + part * (joints.angle[index] - rest), joints.angle[index]),
        torque=part * joints.torque[index],
        feedforward=part * joints.feedforward[index],
        gravity=joints.gravity[index],
        link_angle=rest,
    )
