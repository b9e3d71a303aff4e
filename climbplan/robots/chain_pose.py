"""Kinematics of chains of joints given by joints, axes and toe at zero angles (body frame).

Moving joint j turns all beyond it about axis a_j through p_j, or slides it along s_j (product of
exponentials), so that at zero angles every link's frame is parallel to the body's and no frames
need to be stored. A joint turns (a_j a unit vector, s_j zero) or slides (the other way round); both
are zero where a limb has no such joint. Joints that follow another one of their limb (mimic joints)
move by it alone: `drive` says how far each moves when another does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.rotations import skew

RADIAN = 0.25  # [m] of a prismatic joint that count as one radian of a revolute one


@dataclass(frozen=True)
class ChainPose:
    """Chains at given angles, in the body frame."""

    joints: Array  # (..., N, J, 3) [m]; of a sliding joint the place that it slides away from
    axes: Array  # (..., N, J, 3) unit, zero where a joint does not turn
    toe: Array  # (..., N, 3) [m]
    places: Array  # (..., N, J, 3) where the link that a joint moves has what was at the joint [m]
    turns: Array  # (..., N, J, 3, 3) of that link, from zero angles
    slides: Array | None = None  # (..., N, J, 3) directions of sliding joints; None: none does
    drive: Array | None = None  # (N, J, J) motions of joints by their angles; None: each its own

    @property
    def columns(self) -> Array:
        """Toe velocity by each joint's own speed (..., N, J, 3): a_j x (toe - p_j) + s_j."""
        turning = np.cross(self.axes, self.toe[..., None, :] - self.joints)
        return turning if self.slides is None else turning + self.slides

    @property
    def jacobian(self) -> Array:
        """Jacobian (..., N, 3, J) of the toe by the angles."""
        by_joint = np.swapaxes(self.columns, -1, -2)
        return by_joint if self.drive is None else by_joint @ self.drive

    @property
    def turning(self) -> Array:
        """Angular velocity of the last link by joint speed (..., N, 3, J)."""
        by_joint = np.swapaxes(self.axes, -1, -2)
        return by_joint if self.drive is None else by_joint @ self.drive

    @property
    def hessian(self) -> Array:
        """Second derivatives (..., N, 3, J, J) of the toe by the angles: a_i x column_j, i <= j."""
        columns = self.columns
        count = columns.shape[-2]
        second = np.empty((*columns.shape[:-2], 3, count, count))
        for i in range(count):
            column = np.cross(self.axes[..., i, None, :], columns[..., i:, :])
            second[..., i, i:] = second[..., i:, i] = np.swapaxes(column, -1, -2)
        if self.drive is None:
            return second
        drive = self.drive[..., None, :, :]
        return np.asarray(np.swapaxes(drive, -1, -2) @ second @ drive)


@dataclass(frozen=True)
class ChainZero:
    """Chains at zero angles: one, N limbs, or any list of them."""

    joints: Array  # (..., J, 3) points on the joint axes [m]
    axes: Array  # (..., J, 3) unit; zero where a joint does not turn
    toe: Array  # (..., 3) [m]
    slides: Array | None = None  # (..., J, 3) directions of joints that slide; None: none does
    drive: Array | None = None  # (..., J, J) motions by angles; None: each joint moves by its own

    def rows(self, index: IntArray) -> Self:
        """Return chains by index, some of them or the same ones several times."""
        return type(self)(
            self.joints[index],
            self.axes[index],
            self.toe[index],
            None if self.slides is None else self.slides[index],
            None if self.drive is None else self.drive[index],
        )

    @cached_property
    def moves(self) -> BoolArray:
        """Whether an angle moves anything (..., J): its joint exists and mimics no other."""
        exists = np.abs(self.axes).max(axis=-1) > 0
        if self.slides is not None:
            exists = exists | (np.abs(self.slides).max(axis=-1) > 0)
        if self.drive is None:
            return np.asarray(exists)
        return np.asarray((np.abs(self.drive) * exists[..., :, None]).max(axis=-2) > 0)

    @cached_property
    def unit(self) -> Array:
        """Units of angles (..., J): 1 of rotations, `RADIAN` of lengths."""
        if self.slides is None:
            return np.ones(self.axes.shape[:-1])
        return np.where(np.abs(self.slides).max(axis=-1) > 0, RADIAN, 1.0)

    def in_radians(self) -> Self:
        """Return the same chains with lengths of prismatic joints counted in `RADIAN`."""
        if self.slides is None:
            return self
        unit = self.unit
        drive = self.drive
        if drive is not None:
            drive = drive * unit[..., None, :] / unit[..., :, None]
        return replace(self, slides=RADIAN * self.slides, drive=drive)

    def motions(self, angles: Array) -> Array:
        """Return how far each joint is from zero (..., J), for angles (..., J)."""
        if self.drive is None:
            return angles
        return np.asarray((self.drive @ angles[..., None])[..., 0])

    def pose(self, angles: Array) -> ChainPose:
        """Return the chains at angles (..., J) [rad, or m of prismatic joints]."""
        joint_zero, axis_zero, toe_zero = self.joints, self.axes, self.toe
        motions = self.motions(angles)
        count = motions.shape[-1]
        cross = skew(axis_zero)  # (..., J, 3, 3)
        square = cross @ cross
        sin, cos = np.sin(motions)[..., None, None], np.cos(motions)[..., None, None]
        turn = np.eye(3) + sin * cross + (1.0 - cos) * square  # Rodrigues; 1 where the axis is zero
        ends = np.concatenate([joint_zero, toe_zero[..., None, :]], axis=-2)
        links = np.diff(ends, axis=-2)  # (..., J, 3)
        if self.slides is not None:  # all beyond a sliding joint, seen from before it
            links = links + motions[..., None] * self.slides
        shape = np.broadcast_shapes(motions.shape[:-1], joint_zero.shape[:-2])
        rotation = np.broadcast_to(np.eye(3), (*shape, 3, 3))
        origin = np.broadcast_to(joint_zero[..., 0, :], (*shape, 3))
        joints, axes = np.empty((*shape, count, 3)), np.empty((*shape, count, 3))
        turns = np.empty((*shape, count, 3, 3))
        slides, places = None, joints
        if self.slides is not None:
            slides, places = np.empty((*shape, count, 3)), np.empty((*shape, count, 3))
        for j in range(count):
            joints[..., j, :] = origin
            axes[..., j, :] = (rotation @ axis_zero[..., j, :, None])[..., 0]
            rotation = rotation @ turn[..., j, :, :]
            turns[..., j, :, :] = rotation
            if slides is not None and self.slides is not None:
                slides[..., j, :] = (rotation @ self.slides[..., j, :, None])[..., 0]
                places[..., j, :] = origin + motions[..., j, None] * slides[..., j, :]
            origin = origin + (rotation @ links[..., j, :, None])[..., 0]
        return ChainPose(joints, axes, origin, places, turns, slides, self.drive)
