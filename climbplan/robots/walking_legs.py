"""Legs of a walking robot with joints and motors, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain


@dataclass(frozen=True)
class WalkingLegs:
    """Four legs of three joints, in the order left front, right front, left hind, right hind."""

    chain: SerialChain  # body frame of walking; its posture is how the robot stands
    lower: Array  # (4, 3) [rad]
    upper: Array  # (4, 3) [rad]
    max_torque: Array  # (4, 3) [N m]
    max_speed: Array  # (4, 3) [rad/s]
