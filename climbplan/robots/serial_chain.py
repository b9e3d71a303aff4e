"""Limbs that are chains of any number of revolute and prismatic joints (`chain_pose.py`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.chain_inverse import chain_inverse
from climbplan.robots.chain_pose import ChainPose, ChainZero
from climbplan.robots.mechanism import InverseKinematics, Miss
from climbplan.robots.pose_inverse import pose_inverse

_AT_BOUND = 1e-6  # [rad], [m]
_ON_AXIS = 1e-9  # [m] off the last joint's axis, below which a toe has no direction
_MIN_TILT = 0.1  # [deg] of a sole off its surface, that messages mention
_ALONG_RATIO = 0.7  # of the missing distance, that lies along the limb for "too far"


@dataclass(frozen=True)
class SerialChain:
    """N chains of up to J joints; P = J + 1 points.

    Angles of joints that slide are lengths [m]. A joint that follows another one (a mimic joint)
    moves by that one's angle, counts as a joint that the limb does not have, and has a name, as its
    link does.
    """

    names: tuple[tuple[str, ...], ...]  # of every limb's joints, from the body to the toe
    joint_zero: Array  # (N, J, 3) points on the joint axes at zero angles [m]
    axis_zero: Array  # (N, J, 3) unit axes at zero angles; zero of other joints than turning ones
    toe_zero: Array  # (N, 3) toes at zero angles [m]
    posture: Array  # (N, J) angles that a limb with freedom to choose stays nearest to [rad]
    slide_zero: Array | None = None  # (N, J, 3) unit, of joints that slide; None: none does
    drive: Array | None = None  # (N, J, J) motions by angles, unless each joint has its own

    @property
    def joint_names(self) -> tuple[tuple[str, ...], ...]:
        """Names of every limb's joints that have angles, from the body to the toe."""
        if self.drive is None:
            return self.names
        return tuple(
            tuple(name if has_angle else "" for name, has_angle in zip(row, moves, strict=True))
            for row, moves in zip(self.names, self.zero.moves, strict=True)
        )

    @property
    def slides_zero(self) -> Array:
        """Directions `slide_zero` (N, J, 3), zeros where no joint is prismatic."""
        return np.zeros_like(self.axis_zero) if self.slide_zero is None else self.slide_zero

    @property
    def drives(self) -> Array:
        """The `drive` (N, J, J), the identity where each joint moves by its own angle."""
        if self.drive is not None:
            return self.drive
        limbs, joints = self.posture.shape
        return np.tile(np.eye(joints), (limbs, 1, 1))

    @property
    def sliding(self) -> BoolArray:
        """Prismatic joints (N, J)."""
        if self.slide_zero is None:
            return np.zeros(self.axis_zero.shape[:-1], bool)
        return np.asarray(np.abs(self.slide_zero).max(axis=-1) > 0)

    @property
    def joint_count(self) -> int:
        """The number of joints J."""
        return self.axis_zero.shape[1]

    @property
    def zero(self) -> ChainZero:
        """The chains at zero angles."""
        return ChainZero(
            self.joint_zero, self.axis_zero, self.toe_zero, self.slide_zero, self.drive
        )

    def only(self, limbs: slice) -> Self:
        """Return the chains of some limbs."""
        return self.select_limbs(list(range(len(self.names)))[limbs])

    def select_limbs(self, limbs: Sequence[int]) -> Self:
        """Return the limbs of these indices, in this order."""
        limbs = list(limbs)
        return type(self)(
            tuple(self.names[limb] for limb in limbs),
            self.joint_zero[limbs],
            self.axis_zero[limbs],
            self.toe_zero[limbs],
            self.posture[limbs],
            None if self.slide_zero is None else self.slide_zero[limbs],
            None if self.drive is None else self.drive[limbs],
        )

    def rotate(self, turn: Array) -> Self:
        """Return the same chains in other axes of the body.

        turn: rotation (3, 3) to the other axes.
        """
        return replace(
            self,
            joint_zero=self.joint_zero @ turn.T,
            axis_zero=self.axis_zero @ turn.T,
            toe_zero=self.toe_zero @ turn.T,
            slide_zero=None if self.slide_zero is None else self.slide_zero @ turn.T,
        )

    def pose(self, angles: Array) -> ChainPose:
        """Return joints, axes and toes for angles (..., N, J) [rad]."""
        return self.zero.pose(angles)

    def joint_points(self, angles: Array) -> Array:
        """Return joints and toe (..., N, J + 1, 3) in the body frame [m] for angles (..., N, J)."""
        pose = self.pose(angles)
        return np.concatenate([pose.joints, pose.toe[..., None, :]], axis=-2)

    def jacobian(self, angles: Array) -> Array:
        """Return d(toe)/d(angles) (..., N, 3, J) [m/rad, or 1 of prismatic joints]."""
        return self.pose(angles).jacobian

    def turning(self, angles: Array) -> Array:
        """Return the angular velocity of the toe's link by joint speed (..., N, 3, J).

        Its columns are the joint axes.
        """
        return self.pose(angles).turning

    def last_link(self, angles: Array) -> Array:
        """Return rows x along the last link, normal to its joint's axis, y across it, z that axis.

        The axis of a prismatic last joint is its direction.
        """
        pose = self.pose(angles)
        z = pose.axes[..., -1, :]
        if pose.slides is not None:
            z = z + pose.slides[..., -1, :]
        direction = pose.toe - pose.joints[..., -1, :]
        direction = direction - (direction * z).sum(axis=-1, keepdims=True) * z
        length = np.linalg.norm(direction, axis=-1, keepdims=True)
        x = direction / np.where(length > _ON_AXIS, length, np.nan)
        return np.stack([x, np.cross(z, x), z], axis=-2)

    def hessian(self, angles: Array) -> Array:
        """Return second derivatives of the toe (..., N, 3, J, J) [m/rad^2]."""
        return self.pose(angles).hessian

    def inverse(
        self, toes: Array, lower: Array, upper: Array, turns: Array | None = None
    ) -> InverseKinematics:
        """Return the angles nearest to `posture` that put the toes at toes; one branch.

        Args:
            toes: Positions (..., N, 3) [m].
            lower: Lower bounds (N, J) [rad].
            upper: Upper bounds (N, J) [rad].
            turns: Rotations (..., N, 3, 3) of last links; None for any. With rotations the angles
                are
                those that Newton's method finds from `posture`.
        """
        batch = toes.shape[:-2]
        limbs = np.broadcast_to(np.arange(toes.shape[-2]), toes.shape[:-1]).ravel()
        if turns is not None:
            return self._solve_poses(
                toes, np.broadcast_to(turns, (*toes.shape, 3)), limbs, lower, upper
            )
        solution = chain_inverse(
            self.zero, self.posture, limbs, toes.reshape(-1, 3), lower[limbs], upper[limbs]
        )
        shape = (*batch, 1, toes.shape[-2])
        reachable = solution.reached.reshape(shape)
        return InverseKinematics(
            angles=solution.angles.reshape(*shape, -1),
            reachable=reachable,
            within_bounds=reachable,  # bounds are kept all the way
            missing=np.where(reachable, 0.0, solution.missing.reshape(shape)),
        )

    def _solve_poses(
        self,
        toes: Array,
        turns: Array,
        limbs: IntArray,
        lower: Array,
        upper: Array,
    ) -> InverseKinematics:
        """Return angles with given rotations of last links."""
        solution = pose_inverse(
            self.zero.rows(limbs),
            self.posture[limbs],
            toes.reshape(-1, 3),
            turns.reshape(-1, 3, 3),
            lower[limbs],
            upper[limbs],
        )
        shape = (*toes.shape[:-2], 1, toes.shape[-2])
        reachable = solution.reached.reshape(shape)
        missing, tilted = (solution.missing[:, k].reshape(shape) for k in range(2))
        return InverseKinematics(
            angles=solution.angles.reshape(*shape, -1),
            reachable=reachable,
            within_bounds=reachable,
            missing=np.where(reachable, 0.0, missing),
            tilted=np.where(reachable, 0.0, tilted),
        )

    def explain_miss(
        self, solution: InverseKinematics, toes: Array, limb: int, lower: Array, upper: Array
    ) -> Miss:
        """Explain why limb `limb` of a solution for toes (N, 3) is not valid.

        The reason names the joints at their bounds.
        """
        angles = solution.angles[0, limb]
        missing = float(solution.missing[0, limb])
        gap = np.minimum(angles - lower[limb], upper[limb] - angles)
        names = zip(self.names[limb], gap, strict=True)
        stopped = ", ".join(name for name, margin in names if name and margin < _AT_BOUND)
        points = self.only(slice(limb, limb + 1)).joint_points(angles[None])[0]
        first, toe = points[0], points[-1]
        beyond = float(np.linalg.norm(toes[limb] - first) - np.linalg.norm(toe - first))
        if solution.tilted is not None:
            tilt = np.rad2deg(float(solution.tilted[0, limb]))
            suffix = f" ({stopped} at its bound)" if stopped else ""
            if tilt > _MIN_TILT:
                return Miss(f"its sole {tilt:.1f} deg off its surface{suffix}, and", missing)
        if stopped and abs(beyond) < _ALONG_RATIO * missing:
            return Miss(f"stopped by the bound of {stopped}", missing)
        direction = "too far" if beyond > 0 else "too near"
        return Miss(f"{direction} ({stopped} at its bound)" if stopped else direction, missing)
