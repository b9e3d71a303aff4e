"""Torque limits, speeds and stiffness of joints: the URDF's, or assumed where implausible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.workspace import select_common_reach
from climbplan.schema.robots.urdf.model import FEWEST_FLAT_FEET
from climbplan.schema.robots.urdf.tree import UrdfJoint

GRAVITY = 9.81  # [m/s^2]
_MAX_TORQUE_RATIO = 10.0  # torque limit over what holds the whole robot at the limb's end
_MAX_SPEED = 60.0  # [rad/s]
_ASSUMED_TORQUE_RATIO = 1.5  # over what holds a leg's part of the weight at its full length
_ASSUMED_SPEED_RATIO = 3.5  # over the root of gravity over the limb's length [1/s]
_FULL_TORQUE_ERROR = 0.25  # [rad] off its command, at which a joint gives its full torque
_MIN_STIFFNESS_RATIO = 4.0  # [1/rad] stiffness over weight times reach
_ARM_FACTOR = 1.5  # on that ratio, for robots with arms: more weight is above the hips
_BIPED_FACTOR = 3.0  # on that ratio, for bipeds: one leg on a narrow foot bears it all
_CYCLE_TIME = 0.01  # [s] that crossing this error takes at full speed, at least
_DIGITS = 2


@dataclass(frozen=True)
class Motor:
    """Limits and stiffness of one joint; None where the URDF's own are taken."""

    stiffness: float  # [N m/rad]
    max_torque: float | None = None
    max_speed: float | None = None


@dataclass
class JointMotors:
    """Motors by joint, and implausible data of the URDF."""

    joints: dict[str, Motor] = field(default_factory=dict)
    implausible: list[str] = field(default_factory=list)

    @property
    def stiffness(self) -> float:
        """The stiffness of most joints [N m/rad]."""
        values = [motor.stiffness for motor in self.joints.values()]
        return max(sorted(set(values)), key=values.count)

    def list_torque_limits(self, joints: Sequence[UrdfJoint]) -> list[float]:
        """List the torque limits of joints [N m]; 0 of those that neither has a limit for."""
        return [self.joints[j.name].max_torque or float(j.effort or 0.0) for j in joints]


def propose_motors(legs: list[tuple[UrdfJoint, ...]], reach: Array, weight: float) -> JointMotors:
    """Return limits and stiffness of all joints of legs.

    Stiffness is the P gain with which a joint gives its full torque 0.25 rad (14 degrees) off its
    command: compliant enough that a toe a few millimetres off its place does not use up the motor.
    For joints that cross this error in less than a cycle of 10 ms it is the angle of a cycle. A
    lower bound keeps the body on its springs from buckling: 4 times weight times the reach of a
    leg, half as much again for robots with arms, and three times as much for two legs.

    Speed limits that the URDF lacks scale with size as pendulums do: 3.5 times the root of gravity
    over the limb's length.

    Args:
        legs: Joints of N legs.
        reach: Reach of each leg (N,) [m].
        weight: Weight of the robot [N].
    """
    motors = JointMotors()
    implausible: dict[str, list[str]] = {}
    common_reach = select_common_reach(reach)
    for joints, length in zip(legs, reach, strict=True):
        full_moment = weight * float(length)
        min_stiffness = _MIN_STIFFNESS_RATIO * weight * max(float(length), common_reach)
        if common_reach > float(reach.min()):
            min_stiffness *= _ARM_FACTOR
        if len(legs) == FEWEST_FLAT_FEET:
            min_stiffness *= _BIPED_FACTOR
        assumed_torque = _round_to_digits(_ASSUMED_TORQUE_RATIO * full_moment / len(legs))
        for joint in joints:
            torque, speed = joint.effort or 0.0, joint.velocity or 0.0
            max_torque = torque
            if not 0 < torque <= _MAX_TORQUE_RATIO * full_moment:
                max_torque = assumed_torque
                data = f"effort {torque:g} N m" if torque > 0 else "no effort limit"
                implausible.setdefault(f"{data}; {assumed_torque:g} N m ASSUMED", []).append(
                    joint.name
                )
            max_speed = speed
            if not 0 < speed <= _MAX_SPEED:
                max_speed = _round_to_digits(
                    min(_ASSUMED_SPEED_RATIO * np.sqrt(GRAVITY / float(length)), _MAX_SPEED)
                )
                data = f"velocity {speed:g} rad/s" if speed > 0 else "no velocity limit"
                implausible.setdefault(f"{data}; {max_speed:g} rad/s ASSUMED", []).append(
                    joint.name
                )
            error = max(_FULL_TORQUE_ERROR, _CYCLE_TIME * max_speed)
            motors.joints[joint.name] = Motor(
                _round_to_digits(max(max_torque / error, min_stiffness)),
                None if max_torque == torque else max_torque,
                None if max_speed == speed else max_speed,
            )
    motors.implausible += [f"{_list_names(names)}: {data}" for data, names in implausible.items()]
    return motors


def _round_to_digits(value: float) -> float:
    """Return a value with two significant digits; 1 unless it is finite and positive."""
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) and value > 0 else 1.0


def _list_names(names: list[str]) -> str:
    """Return the first three names, and how many more there are."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"{', '.join(names[:3])}{more}"
