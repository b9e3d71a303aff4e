"""Torque limits, speeds and stiffness that a URDF says, and what to take where it says nonsense."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.workspace import common_reach
from climbplan.schema.robots.urdf.model import FEWEST_FLAT_FEET
from climbplan.schema.robots.urdf.tree import UrdfJoint

GRAVITY = 9.81  # [m/s^2]
_MOST = 10.0  # times what holds the whole robot at the end of the limb: no motor of its has that
_FASTEST = 60.0  # [rad/s]
_OWN_TORQUE = 1.5  # times what holds a leg's share of the weight at its full length
_OWN_SPEED = 3.5  # times the root of gravity over the limb's length [1/s]
_OFF = 0.25  # [rad] off its command at which a joint is to give all of its torque
_UPRIGHT = 4.0  # [1/rad] of weight times reach that stiffness is at least
_TOP_HEAVY = 1.5  # times that where arms stand beside legs: more weight is above hips
_ON_ONE = 3.0  # times that of bipeds, of which one leg at a time bears it all, narrow at its foot
_CYCLE = 0.01  # [s] that it takes for that at its full speed, at least
_DIGITS = 2


@dataclass(frozen=True)
class Motor:
    """One joint's limits and stiffness; None where the URDF's own are taken."""

    stiffness: float  # [N m/rad]
    max_torque: float | None = None
    max_speed: float | None = None


@dataclass
class Motors:
    """Joints by name, and what the URDF says that nobody can mean."""

    joints: dict[str, Motor] = field(default_factory=dict)
    odd: list[str] = field(default_factory=list)

    @property
    def stiffness(self) -> float:
        """That of most joints [N m/rad]."""
        values = [motor.stiffness for motor in self.joints.values()]
        return max(sorted(set(values)), key=values.count)


def motors_of(legs: list[tuple[UrdfJoint, ...]], reach: Array, weight: float) -> Motors:
    """Limits and stiffness of all joints of legs with reach (N,) [m]; weight: of the robot [N].

    Stiffness is the P gain with which a joint gives its whole torque 0.25 rad (14 degrees) off its
    command, slack enough that a toe a few millimetres off its place does not use up the motor. For
    joints so fast that they cross that in less than a cycle of 10 ms it is the angle of a cycle. It
    is more where the robot is heavy for its motors: 4 times its weight times a leg's reach, with
    which the body on its springs does not buckle. Where arms stand beside legs it is half as much
    again, with the reach of the legs; of two legs three times as much.

    Speeds that no URDF says go by size, as pendulums do: 3.5 times the root of gravity over the
    limb's length. The slowest joints of eight quadrupeds whose URDFs say them have 2.0 to 6.3 times
    that, in the median 3.9.
    """
    found = Motors()
    odd: dict[str, list[str]] = {}
    common = common_reach(reach)
    for joints, length in zip(legs, reach, strict=True):
        holds = weight * float(length)
        upright = _UPRIGHT * weight * max(float(length), common)
        if common > float(reach.min()):
            upright *= _TOP_HEAVY
        if len(legs) == FEWEST_FLAT_FEET:
            upright *= _ON_ONE
        own = _rounded(_OWN_TORQUE * holds / len(legs))
        for joint in joints:
            torque, speed = joint.effort or 0.0, joint.velocity or 0.0
            taken = torque
            if not 0 < torque <= _MOST * holds:
                taken = own
                what = f"effort {torque:g} N m" if torque > 0 else "no effort limit"
                odd.setdefault(f"{what}; {own:g} N m ASSUMED", []).append(joint.name)
            fast = speed
            if not 0 < speed <= _FASTEST:
                fast = _rounded(min(_OWN_SPEED * np.sqrt(GRAVITY / float(length)), _FASTEST))
                what = f"velocity {speed:g} rad/s" if speed > 0 else "no velocity limit"
                odd.setdefault(f"{what}; {fast:g} rad/s ASSUMED", []).append(joint.name)
            off = max(_OFF, _CYCLE * fast)
            found.joints[joint.name] = Motor(
                _rounded(max(taken / off, upright)),
                None if taken == torque else taken,
                None if fast == speed else fast,
            )
    found.odd += [f"{_listed(names)}: {what}" for what, names in odd.items()]
    return found


def _rounded(value: float) -> float:
    """To two digits."""
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) and value > 0 else 1.0


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"{', '.join(names[:3])}{more}"
