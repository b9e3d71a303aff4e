"""Grippers on spherical wrists: joint angles and torques of wrists.

A wrist sits at the end of a limb's last link, whose frame has x along the link, y across it in the
limb's plane (towards body z where the link points down), and z along the last joint's axis. Joint 1
turns about y, joint 2 about the z it carries along, joint 3 about the gripper's approach.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from climbplan.arrays import Array
from climbplan.schema.robots.gripper import GripperSpec

WRIST_JOINTS = ("wrist 1", "wrist 2", "wrist 3")


@dataclass(frozen=True)
class Gripper:
    """The grippers of a robot, the same on every limb."""

    length: float  # from the wrist's centre to the grip's [m]
    finger_span: float  # [m]
    max_force: float  # of each finger [N]; 0: they stay open
    wrist_max_torque: Array  # (3,) [N m]
    wrist_lower: Array  # (3,) [rad]
    wrist_upper: Array  # (3,) [rad]

    @classmethod
    def from_spec(cls, spec: GripperSpec) -> Self:
        """Build the arrays of a validated gripper spec."""
        return cls(
            length=spec.length,
            finger_span=spec.finger_span,
            max_force=spec.max_force,
            wrist_max_torque=np.array(spec.wrist_max_torque, float),
            wrist_lower=np.deg2rad(spec.wrist_lower_deg),
            wrist_upper=np.deg2rad(spec.wrist_upper_deg),
        )


@dataclass(frozen=True)
class Wrists:
    """Wrists that press grippers against a surface."""

    angles: Array  # (..., 3) [rad]
    axes: Array  # (..., 3, 3) rows: unit axes of the three joints


def wrists_at(link: Array, approach: Array, closing: Array) -> Wrists:
    """Return wrist angles that point the gripper along `approach`, its fingers along `closing`.

    Two fingers are the same after half a turn: joint 3 takes the smaller rotation.

    Args:
        link: Rows x, y, z (..., 3, 3) of the last link's frame.
        approach: Unit direction (..., 3).
        closing: Unit direction (..., 3) at right angles to it.
    """
    x, y, z = link[..., 0, :], link[..., 1, :], link[..., 2, :]
    second = np.arcsin(np.clip(_dot(approach, y), -1.0, 1.0))
    first = np.arctan2(-_dot(approach, z), _dot(approach, x))
    cos, sin = np.cos(first)[..., None], np.sin(first)[..., None]
    tilted_z = sin * x + cos * z  # z after joint 1, the axis of joint 2
    across = np.cross(tilted_z, approach)  # y after joints 1 and 2
    third = np.arctan2(_dot(closing, tilted_z), _dot(closing, across))
    third = third - np.pi * np.round(third / np.pi)
    return Wrists(
        angles=np.stack([first, second, third], axis=-1),
        axes=np.stack([y, tilted_z, approach], axis=-2),
    )


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))
