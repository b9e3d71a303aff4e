"""What a robot is commanded: bodies, joints and contacts over time, for any gains.

A plan's joints are springs: a command is the angle plus what the contact forces bend the joint by,
for motors whose P gain is the robot's `joint_stiffness`. Another controller needs other commands
for the same torques, or the torques themselves.

All torques are those of motors: positive ones turn a joint in the positive direction of its axis. A
motor brings `gain (command - angle) + feedforward + gravity`. Contact forces act on the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UnsoundPlan, UsageError


@dataclass(frozen=True)
class BodyMotion:
    """A rigid body, T samples, world frame."""

    name: str
    position: Array  # (T, 3) [m]
    quaternion: Array  # (T, 4) x, y, z, w; body to world


@dataclass(frozen=True)
class ExportedJoints:
    """J joints, T samples; of joints that slide in m for rad and N for N m."""

    names: tuple[str, ...]
    command: Array  # (T, J) for P controllers [rad]
    velocity: Array  # (T, J) of the command [rad/s]
    acceleration: Array  # (T, J) [rad/s^2]
    angle: Array  # (T, J) as encoders will read it [rad]
    torque: Array  # (T, J) that motors bring against contact forces [N m]
    feedforward: Array  # (T, J) of `torque` what controllers add to their P part [N m]
    gravity: Array  # (T, J) what motors add to hold the links' own weight [N m]
    gain: Array  # (J,) P gains that the commands are right for [N m/rad]; zero: position control
    slides: tuple[bool, ...] = ()  # (J,) which do; none if left out
    limits: JointLimits | None = None  # None: nothing is known of motors
    link_angle: Array | None = None  # (T, J) without the structure's give; None: as `angle`
    has_gravity_effort: bool = False  # `effort` in files contains `gravity`

    def is_sliding(self, joint: int) -> bool:
        """Return whether a joint slides."""
        return bool(self.slides and self.slides[joint])

    @property
    def effort(self) -> Array:
        """(T, J) what controllers add to their P part [N m]."""
        return self.feedforward + self.gravity if self.has_gravity_effort else self.feedforward


@dataclass(frozen=True)
class JointLimits:
    """What controllers and simulators have to know of J motors."""

    limb: tuple[str, ...]  # (J,) that each joint belongs to
    rigid_gain: Array  # (J,) P gains of simulators whose links do not bend [N m/rad]
    damping: Array  # (J,) D gains that settle a joint under `gain` [N m s/rad]
    max_torque: Array  # (J,) [N m]


@dataclass(frozen=True)
class ContactMotion:
    """C points that may touch, T samples, world frame."""

    names: tuple[str, ...]
    point: Array  # (T, C, 3) where they touch, beside the centres of spherical feet [m]
    force: Array  # (T, C, 3) on the robot [N]
    touching: BoolArray  # (T, C)


@dataclass(frozen=True)
class LatchMotion:
    """What the E ends of modules hold on to, T samples; A anchors on boxes and terrain."""

    ends: tuple[str, ...]  # (E,) "A_first"
    anchor: IntArray  # (T, E) number in `anchor_names`, -1 of nothing, -2 of the ground
    anchor_names: tuple[str, ...]  # (A + E,): anchors, then the ends themselves
    anchor_position: Array  # (T, A, 3) world frame [m]

    def name_of(self, anchor: int) -> str:
        """Return what a number in `anchor` stands for."""
        return {-1: "nothing", -2: "the ground"}.get(anchor) or self.anchor_names[anchor]


@dataclass(frozen=True)
class LimbLinks:
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
    joints: ExportedJoints | None
    contacts: ContactMotion | None
    latches: LatchMotion | None = None  # of modules
    base: BodyMotion | None = None  # root link of the URDF; None: the robot has none
    limbs: tuple[LimbLinks, ...] = ()
    body_size: Array | None = None  # (3,) half lengths of the first body's box [m]
    surfaces: tuple[Array, ...] = ()  # (V, 3) corners of each [m]
    words: tuple[str, ...] = ()  # what users of the file have to know
    facts: Mapping[str, object] = field(default_factory=dict)  # what files tell beside the samples
    # Of a motion that is known at all times, not at samples alone: the motion at times (M,)
    sampler: Callable[[Array], RobotMotion] | None = None
    changes: Array | None = None  # (K,) times at which forces that are held change [s]
    ramp: float = 0.0  # [s] before and after the plan in which contacts take load and give it up

    @property
    def placed(self) -> tuple[BodyMotion, ...]:
        """All bodies, and the root link of the URDF after them."""
        return self.bodies if self.base is None else (*self.bodies, self.base)


def describe_gains(gain: Array, feedforward: bool = False, slides: tuple[bool, ...] = ()) -> str:
    """Describe the gains that commands hold for.

    Args:
        gain: (J,) P gains [N m/rad], [N/m] of sliding joints.
        feedforward: Whether controllers add the torques themselves.
        slides: (J,) whether a joint slides; () means that none does.
    """
    if feedforward:
        return (
            "commands are the angles at which joints come to rest; controllers have to add the "
            "torques told beside them, or the robot sags"
        )
    return (
        f"commands hold for controllers whose P gains are {_format_ranges(gain, slides)}; for "
        "others give --gains or --feedforward"
    )


def describe_rigid_gains(gain: Array, slides: tuple[bool, ...] = ()) -> str:
    """Return what a user of `--gains rigid` has to know; gain: (J,) as `describe_gains`."""
    return (
        "commands and angles hold for simulators whose links do not bend, with P gains of "
        f"{_format_ranges(gain, slides)}; the robot itself needs a file without --gains rigid"
    )


def _format_ranges(gain: Array, slides: tuple[bool, ...]) -> str:
    sliding = np.array(slides or (False,) * len(gain))
    kinds = ((gain[~sliding], "N m/rad"), (gain[sliding], "N/m"))
    return " and ".join(f"{_format_range(gains)} {unit}" for gains, unit in kinds if len(gains))


def _format_range(values: Array) -> str:
    if np.ptp(values) == 0:
        return f"{values.min():.4g}"
    return f"{values.min():.4g} to {values.max():.4g}"


def require_increasing(time: Array) -> None:
    """Raise UnsoundPlan if a sample (T,) [s] is not after the one before: that is no motion."""
    wrong = np.flatnonzero(~(np.diff(time) > 0) | ~np.isfinite(time[1:]))
    if len(wrong):
        k = int(wrong[0]) + 1
        raise UnsoundPlan(
            f"time: sample {k} at {time[k]:g} s, the one before at {time[k - 1]:g} s; expected "
            "times that increase: plan again, `climbplan verify` lists what else is wrong"
        )


def differentiate_spline(time: Array, values: Array) -> tuple[Array, Array]:
    """Return first and second derivative of the cubic spline through values, at rest at its ends.

    Args:
        time: (T,) increasing [s].
        values: (T, ...) of any unit.

    Returns:
        Two arrays (T, ...), per second and per second squared; zeros for two samples or fewer.
    """
    if len(time) < 3:
        return np.zeros_like(values), np.zeros_like(values)
    require_increasing(time)
    spline = CubicSpline(time, values, axis=0, bc_type="clamped")
    return spline(time, 1), spline(time, 2)


def unwrap_quaternions(quaternion: Array) -> Array:
    """Return the same rotations (T, 4), each on the side of the one before.

    Readers may interpolate between them.
    """
    flips = (quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0
    sign = np.concatenate([[1.0], np.where(np.cumsum(flips) % 2, -1.0, 1.0)])
    return np.asarray(quaternion * sign[:, None])


def convert_to_gains(
    joints: ExportedJoints, gain: Array, feedforward: bool, time: Array
) -> ExportedJoints:
    """Return commands that bring the same torques at the same angles under P gains (J,) [N m/rad].

    tau = gain (command - angle) + feedforward: with feed-forward all torques are told apart and
    commands are the angles; without, command = angle + tau / gain. Raises UsageError where torques
    need gains that there are not.
    """
    feedforward_torque = joints.torque if feedforward else np.zeros_like(joints.torque)
    feedback_torque = joints.torque - feedforward_torque
    if feedback_torque.any() and not (gain > 0).all():
        low = [name for name, g in zip(joints.names, gain, strict=True) if not g > 0]
        raise UsageError(f"P gains must be positive: {', '.join(low)}; or use --feedforward")
    command = joints.angle + np.divide(
        feedback_torque, gain, out=np.zeros_like(feedback_torque), where=gain > 0
    )
    velocity, acceleration = differentiate_spline(time, command)
    return replace(
        replace_gain(joints, gain),
        command=command,
        velocity=velocity,
        acceleration=acceleration,
        feedforward=feedforward_torque,
    )


def replace_gain(joints: ExportedJoints, gain: Array) -> ExportedJoints:
    """Return joints whose controllers have P gains (J,) [N m/rad], and D gains that go with them.

    Commands are left as they are.
    """
    limits = joints.limits
    if limits is not None:  # critical damping grows with the square root of stiffness
        stiffer = np.divide(gain, joints.gain, out=np.ones_like(gain), where=joints.gain > 0)
        limits = replace(limits, damping=limits.damping * np.sqrt(stiffer))
    return replace(joints, gain=gain, limits=limits)


def convert_to_rigid_links(
    joints: ExportedJoints, feedforward: bool, time: Array
) -> ExportedJoints:
    """Return the motion for simulators whose links do not bend: gains K (1 - share), angles of the
    links.

    The compliance of the structure is counted to the joints, so that the same commands press with
    the same forces. Raises UsageError where nothing is known of motors.
    """
    if joints.limits is None:
        raise UsageError(
            "--gains rigid: the plan has no data of the robot's motors; expected a number or a file"
        )
    angle = joints.angle if joints.link_angle is None else joints.link_angle
    rigid_joints = replace(joints, angle=angle, link_angle=angle)
    return convert_to_gains(rigid_joints, joints.limits.rigid_gain, feedforward, time)
