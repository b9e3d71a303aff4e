"""Chains of revolute joints told by where joints, axes and toe are at zero angles (body frame).

Turning joint j turns all beyond it about axis a_j through p_j (product of exponentials), so that at
zero angles every link's frame is parallel to the body's and no frames need to be stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from climbplan.robots.rotations import Array, skew


@dataclass(frozen=True)
class ChainPose:
    """Chains at given angles, in the body frame."""

    joints: Array  # (..., N, J, 3) [m]
    axes: Array  # (..., N, J, 3) unit, zero where a limb has no such joint
    toe: Array  # (..., N, 3) [m]
    turns: Array  # (..., N, J, 3, 3) of the link that each joint moves, from zero angles

    @property
    def jacobian(self) -> Array:
        """(..., N, 3, J): column j is a_j x (toe - p_j)."""
        return np.swapaxes(np.cross(self.axes, self.toe[..., None, :] - self.joints), -1, -2)

    @property
    def hessian(self) -> Array:
        """(..., N, 3, J, J) of the toe by the angles: a_i x (a_j x (toe - p_j)), i <= j."""
        columns = np.cross(self.axes, self.toe[..., None, :] - self.joints)  # (..., N, J, 3)
        count = columns.shape[-2]
        out = np.empty((*columns.shape[:-2], 3, count, count))
        for i in range(count):
            later = np.cross(self.axes[..., i, None, :], columns[..., i:, :])
            out[..., i, i:] = out[..., i:, i] = np.swapaxes(later, -1, -2)
        return out


@dataclass(frozen=True)
class ChainZero:
    """Chains at zero angles: one, N limbs, or any list of them."""

    joints: Array  # (..., J, 3) points on the joint axes [m]
    axes: Array  # (..., J, 3) unit; zero where a limb has no such joint
    toe: Array  # (..., 3) [m]

    def rows(self, index: NDArray[np.int64]) -> Self:
        """Some of the chains, or the same ones several times."""
        return type(self)(self.joints[index], self.axes[index], self.toe[index])

    def turned(self, angles: Array) -> Array:
        """How links beyond each joint are turned from zero angles (..., J, 3, 3), at (..., J)."""
        cross = skew(self.axes)
        sin, cos = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
        turned: Array = np.eye(3) + sin * cross + (1.0 - cos) * (cross @ cross)  # Rodrigues
        for j in range(1, angles.shape[-1]):
            turned[..., j, :, :] = turned[..., j - 1, :, :] @ turned[..., j, :, :]
        return turned

    def pose(self, angles: Array) -> ChainPose:
        """The chains at angles (..., J) [rad]."""
        joint_zero, axis_zero, toe_zero = self.joints, self.axes, self.toe
        count = angles.shape[-1]
        cross = skew(axis_zero)  # (..., J, 3, 3)
        square = cross @ cross
        sin, cos = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
        turn = np.eye(3) + sin * cross + (1.0 - cos) * square  # Rodrigues; 1 where the axis is zero
        ends = np.concatenate([joint_zero, toe_zero[..., None, :]], axis=-2)
        links = np.diff(ends, axis=-2)  # (..., J, 3)
        shape = np.broadcast_shapes(angles.shape[:-1], joint_zero.shape[:-2])
        rotation = np.broadcast_to(np.eye(3), (*shape, 3, 3))
        at = np.broadcast_to(joint_zero[..., 0, :], (*shape, 3))
        joints, axes = np.empty((*shape, count, 3)), np.empty((*shape, count, 3))
        turns = np.empty((*shape, count, 3, 3))
        for j in range(count):
            joints[..., j, :] = at
            axes[..., j, :] = (rotation @ axis_zero[..., j, :, None])[..., 0]
            rotation = rotation @ turn[..., j, :, :]
            turns[..., j, :, :] = rotation
            at = at + (rotation @ links[..., j, :, None])[..., 0]
        return ChainPose(joints, axes, at, turns)
