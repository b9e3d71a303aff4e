"""Rotations and numbers as a URDF has them, without loss."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from climbplan.arrays import Array


def rotation(library: Any, quat_wxyz: Any) -> Array:
    """The matrix (3, 3) of one of MuJoCo's quaternions."""
    out = np.zeros(9)
    library.mju_quat2Mat(out, np.array(quat_wxyz, float))
    return out.reshape(3, 3)


def rpy(turn: Array) -> Array:
    """Roll, pitch and yaw (3,) [rad] of a rotation (3, 3), exact where pitch is 90 degrees, too.

    Near there yaw is ill determined; roll is then taken from what yaw has left over.
    """
    yaw = math.atan2(turn[1, 0], turn[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    left = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turn
    pitch = math.atan2(-left[2, 0], left[0, 0])
    return np.array([math.atan2(-left[1, 2], left[1, 1]), pitch, yaw])


def words(values: Iterable[float]) -> str:
    """Numbers as they are read again without loss."""
    return " ".join(repr(float(value)) for value in values)


def origin_element(at: Array, turn: Array | None) -> str:
    """<origin> at a place (3,) [m] with axes (3, 3), None for those of the parent."""
    turned = "" if turn is None else f' rpy="{words(rpy(turn))}"'
    return f'<origin xyz="{words(at)}"{turned}/>'


def line_attribute(line: int) -> str:
    """Where an element is written in the file that it is from."""
    return f' from_line="{line}"'
