"""Limbs that are chains of revolute joints in programs: angles as variables, tied to the toes.

Exact forward kinematics ties them. A limb with more than three joints has freedom to choose and
takes the angles nearest to its posture q0 (`chain_inverse.py`); where its joints are inside their
bounds that is q - q0 = J^T pull for some pull (3,), a variable too. Programs so keep such limbs off
their joint bounds, and have the angles that the plan will have.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.robots.kinematics import inverse
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.stated_limbs import Shapes, Tie


@dataclass(frozen=True)
class ChainsAtToes:
    """N chains with angles that are to put their toes at points."""

    stated: StatedChains
    numbers: Mapping[str, Any]
    toes: Any  # (3, N) body frame [m]
    angles: Any  # (J, N) [rad]
    pull: Any  # (3, N) [rad / m], or None of chains without freedom to choose

    def ties(self, room: float) -> list[Tie]:
        """Forward kinematics, and nothing left to choose; joint bounds are those of variables."""
        toe = self.stated.points(self.numbers, self.angles)[-1]
        ties = [Tie("kinematics.toes", toe - self.toes, "m", 0.0, 0.0)]
        if self.pull is not None:
            off = self.angles - self.numbers["posture"] - self.torques(self.pull)
            ties.append(Tie("kinematics.settled", off, "rad", 0.0, 0.0))
        return ties

    def torques(self, force: Any, moment: Any = None) -> Any:
        """Joint torques J^T f + axes . m (J, N) of forces (3, N) and moments, body frame."""
        joints, axes, toe = self.stated.pose(self.numbers, self.angles)
        arms = (ca.cross(axis, toe - at) for at, axis in zip(joints, axes, strict=True))
        torques = [ca.sum1(arm * force) for arm in arms]
        if moment is not None:
            torques = [t + ca.sum1(axis * moment) for t, axis in zip(torques, axes, strict=True)]
        return ca.vertcat(*torques)

    def free_toes(self, bent: Any) -> Any:
        """Where toes (3, N) would be in free space, body frame, with joints `bent` (J, N) back."""
        return self.stated.points(self.numbers, self.angles - bent)[-1]


@dataclass(frozen=True)
class StatedChains:
    """N chains of up to J joints; those that a limb does not have come first and turn nothing."""

    limbs: int
    joints: int
    redundant: bool  # whether a limb has more than three joints
    # (N, C) joints that move the limbs' capsules; None: links are straight from joint to joint
    mounted: tuple[tuple[int, ...], ...] | None = None
    footed: bool = False

    @property
    def numbers(self) -> Shapes:
        """Joints, axes and toes at zero angles, joint by joint of N columns each, and postures."""
        n = self.limbs
        return {
            "joint_zero": (3, n * self.joints),
            "axis_zero": (3, n * self.joints),
            "toe_zero": (3, n),
            "posture": (self.joints, n),
            **({"foot": (1, 1)} if self.footed else {}),
            **({} if self.mounted is None else {"capsule_zero": (3, 2 * n * len(self.mounted[0]))}),
        }

    @property
    def given(self) -> Shapes:
        """Nothing."""
        return {}

    @property
    def found(self) -> Shapes:
        """Angles, and what pulls a limb with freedom to choose off its posture."""
        angles = {"angles": (self.joints, self.limbs)}
        return angles | ({"pull": (3, self.limbs)} if self.redundant else {})

    def values(self, robot: Robot) -> dict[str, Array]:
        """The robot's numbers."""
        chain = _chain(robot)
        by_joint = {"joint_zero": chain.joint_zero, "axis_zero": chain.axis_zero}
        if robot.capsules is not None:
            n, count = robot.capsules.joint.shape
            by_joint["capsule_zero"] = robot.capsules.ends.reshape(n, 2 * count, 3)
        return {
            **{name: v.transpose(2, 1, 0).reshape(3, -1) for name, v in by_joint.items()},
            "toe_zero": chain.toe_zero.T,
            "posture": chain.posture.T,
            **({} if robot.foot is None else {"foot": np.array([[robot.foot.radius]])}),
        }

    def at_toes(self, robot: Robot, toes: Array) -> dict[str, Array]:
        """Angles for toes (..., N, 3), the nearest there are, and what pulls them there."""
        chain = _chain(robot)
        angles = inverse(robot, toes).angles[..., 0, :, :]
        if not self.redundant:
            return {"angles": angles}
        away = (angles - chain.posture)[..., None]
        pull = np.linalg.pinv(np.swapaxes(chain.jacobian(angles), -1, -2)) @ away
        return {"angles": angles, "pull": pull[..., 0]}

    def pose(self, numbers: Mapping[str, Any], angles: Any) -> tuple[list[Any], list[Any], Any]:
        """Joints and axes, J of (3, N) each, and toes (3, N), body frame, for angles (J, N)."""
        n = self.limbs
        at, axis = (
            [numbers[name][:, j * n : (j + 1) * n] for j in range(self.joints)]
            for name in ("joint_zero", "axis_zero")
        )
        toe = numbers["toe_zero"]
        joints: list[Any] = []
        axes: list[Any] = []
        for j in reversed(range(self.joints)):
            # All beyond the joint turns about it
            toe = at[j] + _turned(axis[j], angles[j, :], toe - at[j])
            joints = [at[j]] + [at[j] + _turned(axis[j], angles[j, :], p - at[j]) for p in joints]
            axes = [axis[j]] + [_turned(axis[j], angles[j, :], a) for a in axes]
        return joints, axes, toe

    def points(self, numbers: Mapping[str, Any], angles: Any) -> list[Any]:
        """Joints and toe (3, N), body frame, for angles (J, N)."""
        joints, _, toe = self.pose(numbers, angles)
        return [*joints, toe]

    def pieces(self, numbers: Mapping[str, Any], angles: Any) -> list[tuple[Any, Any]]:
        """Ends (3, N) of the axis of each capsule, body frame, for angles (J, N)."""
        if self.mounted is None:
            return list(itertools.pairwise(self.points(numbers, angles)))
        n = self.limbs
        ends = []
        for number in range(2 * len(self.mounted[0])):
            columns = []
            for i in range(n):
                point = numbers["capsule_zero"][:, number * n + i]
                for j in reversed(range(self.mounted[i][number // 2] + 1)):
                    at = numbers["joint_zero"][:, j * n + i]
                    axis = numbers["axis_zero"][:, j * n + i]
                    point = at + _turned(axis, angles[j, i], point - at)
                columns.append(point)
            ends.append(ca.horzcat(*columns))
        return list(zip(ends[::2], ends[1::2], strict=True))

    def standing(
        self, numbers: Mapping[str, Any], toes: Any, own: Mapping[str, Any]
    ) -> ChainsAtToes:
        """Chains with toes (3, N) in the body frame."""
        return ChainsAtToes(self, numbers, toes, own["angles"], own.get("pull"))


def _turned(axis: Any, angle: Any, vector: Any) -> Any:
    """Vectors (3, N) turned about unit axes (3, N) by angles (1, N); the same where axes are 0."""
    once = ca.cross(axis, vector)
    sin, rest = (ca.repmat(x, 3, 1) for x in (ca.sin(angle), 1 - ca.cos(angle)))
    return vector + sin * once + rest * ca.cross(axis, once)


def _chain(robot: Robot) -> SerialChain:
    if not isinstance(robot.mechanism, SerialChain):
        raise TypeError("expected a robot whose limbs are chains")
    return robot.mechanism
