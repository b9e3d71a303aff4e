"""What a robot is told: bodies, joints and contacts over time, at any rate and for any gains.

A plan's joints are springs: a command is the angle plus what the contact forces bend the joint by,
for motors whose P gain is the robot's `joint_stiffness`. Another controller needs other commands
for the same torques, or the torques themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from climbplan.errors import UsageError
from climbplan.plans.check import Array

_MOST_RATE = 2000.0  # [Hz]
_MOST_SAMPLES = 2_000_000


@dataclass(frozen=True)
class BodyMotion:
    """A rigid body, T samples, world frame."""

    name: str
    position: Array  # (T, 3) [m]
    quaternion: Array  # (T, 4) x, y, z, w; body to world


@dataclass(frozen=True)
class JointMotion:
    """J joints, T samples; of joints that slide in m for rad and N for N m."""

    names: tuple[str, ...]
    command: Array  # (T, J) what controllers are to be told [rad]
    velocity: Array  # (T, J) of the command [rad/s]
    acceleration: Array  # (T, J) [rad/s^2]
    angle: Array  # (T, J) as encoders will see it [rad]
    torque: Array  # (T, J) that motors bring [N m]
    feedforward: Array  # (T, J) of it what controllers are told beside the command [N m]
    gain: Array  # (J,) P gains that the commands are right for [N m/rad]; none: position control
    slides: tuple[bool, ...] = ()  # (J,) which do; none if left out

    def is_sliding(self, joint: int) -> bool:
        """Whether a joint slides."""
        return bool(self.slides and self.slides[joint])


@dataclass(frozen=True)
class ContactMotion:
    """C points that may touch, T samples, world frame."""

    names: tuple[str, ...]
    point: Array  # (T, C, 3) [m]
    force: Array  # (T, C, 3) on the robot [N]
    touching: NDArray[np.bool_]  # (T, C)


@dataclass(frozen=True)
class LimbShape:
    """A limb as links between points, T samples, world frame."""

    name: str
    points: Array  # (T, P, 3) [m]
    radius: float  # [m]


@dataclass(frozen=True)
class RobotMotion:
    """A plan's motion, T samples."""

    name: str
    robot: str
    time: Array  # (T,) [s], increasing
    bodies: tuple[BodyMotion, ...]
    joints: JointMotion | None
    contacts: ContactMotion | None
    limbs: tuple[LimbShape, ...] = ()
    body_size: Array | None = None  # (3,) half lengths of the first body's box [m]
    surfaces: tuple[Array, ...] = ()  # (V, 3) corners of each [m]
    words: tuple[str, ...] = ()  # what users of the file have to know


def gain_words(gain: Array, feedforward: bool = False, slides: tuple[bool, ...] = ()) -> str:
    """What a user of commands has to know; gain: (J,) [N m/rad], [N/m] of joints that slide."""
    if feedforward:
        return (
            "commands are the angles at which joints come to rest; controllers have to add the "
            "torques told beside them, or the robot sags"
        )
    sliding = np.array(slides or (False,) * len(gain))
    kinds = ((gain[~sliding], "N m/rad"), (gain[sliding], "N/m"))
    spans = " and ".join(f"{_span(own)} {unit}" for own, unit in kinds if len(own))
    return (
        f"commands hold for controllers whose P gains are {spans}; for others give --gains "
        "or --feedforward"
    )


def _span(values: Array) -> str:
    if np.ptp(values) == 0:
        return f"{values.min():.4g}"
    return f"{values.min():.4g} to {values.max():.4g}"


def differentiated(time: Array, values: Array) -> tuple[Array, Array]:
    """First and second derivative (T, ...) of the cubic spline through values at rest at its ends.

    With two samples or fewer nothing moves.
    """
    if len(time) < 3:
        return np.zeros_like(values), np.zeros_like(values)
    spline = CubicSpline(time, values, axis=0, bc_type="clamped")
    return spline(time, 1), spline(time, 2)


def at_rate(motion: RobotMotion, rate: float) -> RobotMotion:
    """The motion at `rate` [Hz], on the cubic splines through its samples.

    What the plan has a sample of is kept exactly. Contacts are those of the sample before. Raises
    UsageError for rates that cannot be.
    """
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
    before = np.searchsorted(motion.time, time, side="right") - 1
    bodies = tuple(
        BodyMotion(
            body.name,
            _smooth(motion.time, body.position, time),
            Slerp(motion.time, Rotation.from_quat(body.quaternion))(time).as_quat(),
        )
        for body in motion.bodies
    )
    return replace(
        motion,
        time=time,
        bodies=bodies,
        joints=None if motion.joints is None else _joints_at(motion.time, motion.joints, time),
        contacts=None if motion.contacts is None else _contacts_at(motion, before, time),
        limbs=tuple(
            replace(limb, points=_smooth(motion.time, limb.points, time)) for limb in motion.limbs
        ),
    )


def for_gains(joints: JointMotion, gain: Array, feedforward: bool, time: Array) -> JointMotion:
    """Commands that bring the same torques at the same angles under P gains (J,) [N m/rad].

    tau = gain (command - angle) + feedforward: with feed-forward all torques are told apart and
    commands are the angles; without, command = angle + tau / gain. Raises UsageError where torques
    need gains that there are not.
    """
    told = joints.torque if feedforward else np.zeros_like(joints.torque)
    asked = joints.torque - told
    if asked.any() and not (gain > 0).all():
        low = [name for name, g in zip(joints.names, gain, strict=True) if not g > 0]
        raise UsageError(f"P gains must be positive: {', '.join(low)}; or use --feedforward")
    command = joints.angle + np.divide(asked, gain, out=np.zeros_like(asked), where=gain > 0)
    velocity, acceleration = differentiated(time, command)
    return replace(
        joints,
        command=command,
        velocity=velocity,
        acceleration=acceleration,
        feedforward=told,
        gain=gain,
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
    )


def _linear(time: Array, values: Array, wanted: Array) -> Array:
    """Torques and forces begin and end within a sample: a spline would swing about them."""
    at = np.clip(np.searchsorted(time, wanted, side="right") - 1, 0, max(len(time) - 2, 0))
    after = np.minimum(at + 1, len(time) - 1)
    span = np.where(after > at, time[after] - time[at], 1.0)
    share = np.clip((wanted - time[at]) / span, 0.0, 1.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - share) * values[at] + share * values[after])


def _contacts_at(motion: RobotMotion, before: NDArray[np.int64], wanted: Array) -> ContactMotion:
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
