"""Rotations and numbers as a URDF has them, without loss."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from climbplan.arrays import Array


def convert_quaternion(library: Any, quat_wxyz: Any) -> Array:
    """Return the matrix (3, 3) of one of MuJoCo's quaternions."""
    out = np.zeros(9)
    library.mju_quat2Mat(out, np.array(quat_wxyz, float))
    return out.reshape(3, 3)


def compute_rpy(rotation_matrix: Array) -> Array:
    """Return roll, pitch and yaw (3,) [rad] of a rotation (3, 3), exact where pitch is 90 degrees,
    too.

    Near there yaw is ill determined; roll is then taken from what yaw has left over.
    """
    yaw = math.atan2(rotation_matrix[1, 0], rotation_matrix[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    without_yaw = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation_matrix
    pitch = math.atan2(-without_yaw[2, 0], without_yaw[0, 0])
    return np.array([math.atan2(-without_yaw[1, 2], without_yaw[1, 1]), pitch, yaw])


def format_numbers(values: Iterable[float]) -> str:
    """Return numbers as they are read again without loss."""
    return " ".join(repr(float(value)) for value in values)


def write_origin(position: Array, axes: Array | None) -> str:
    """Return <origin> at a place (3,) [m] with axes (3, 3), None for those of the parent."""
    rpy_attribute = "" if axes is None else f' rpy="{format_numbers(compute_rpy(axes))}"'
    return f'<origin xyz="{format_numbers(position)}"{rpy_attribute}/>'


def write_line_attribute(line: int) -> str:
    """Return where an element is written in the file that it is from."""
    return f' from_line="{line}"'
