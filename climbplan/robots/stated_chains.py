"""Limbs that are chains of joints in programs: angles as variables, tied to the toes.

Exact forward kinematics ties them. A limb with more than three joints has freedom to choose and
takes the angles nearest to its posture q0 (`chain_inverse.py`); where its joints are inside their
bounds that is q - q0 = U^2 J^T pull for some pull (3,), a variable too, with the units U that
angles are compared in (1 rad, or `RADIAN` of a joint that slides). Programs so keep such limbs off
their joint bounds, and have the angles that the plan will have.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.robots.chain_pose import RADIAN
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
            eased = self.stated.eased(self.numbers, self.torques(self.pull))
            off = self.angles - self.numbers["posture"] - eased
            ties.append(Tie("kinematics.settled", off, "rad", 0.0, 0.0))
        return ties

    def torques(self, force: Any, moment: Any = None) -> Any:
        """Joint torques (J, N) of forces (3, N) on the toes and moments about them, body frame."""
        pose = self.stated.pose(self.numbers, self.angles)
        arms = [
            ca.cross(axis, pose.toe - at) for at, axis in zip(pose.joints, pose.axes, strict=True)
        ]
        if pose.slides:
            arms = [arm + slide for arm, slide in zip(arms, pose.slides, strict=True)]
        torques = [ca.sum1(arm * force) for arm in arms]
        if moment is not None:
            turning = zip(torques, pose.axes, strict=True)
            torques = [torque + ca.sum1(axis * moment) for torque, axis in turning]
        return self.stated.by_angles(self.numbers, ca.vertcat(*torques))

    def free_toes(self, bent: Any) -> Any:
        """Where toes (3, N) would be in free space, body frame, with joints `bent` (J, N) back."""
        return self.stated.points(self.numbers, self.angles - bent)[-1]


@dataclass(frozen=True)
class StatedPose:
    """Chains at given angles, body frame; lists have J entries of (3, N)."""

    joints: list[Any]
    axes: list[Any]
    slides: list[Any]  # empty where no joint slides
    toe: Any  # (3, N)


@dataclass(frozen=True)
class StatedChains:
    """N chains of up to J joints; those that a limb does not have come first and move nothing."""

    limbs: int
    joints: int
    redundant: bool  # whether a limb has more than three joints
    # (N, C) joints that move the limbs' capsules; None: links are straight from joint to joint
    mounted: tuple[tuple[int, ...], ...] | None = None
    slides: bool = False  # whether a joint does
    follows: bool = False  # whether a joint moves by the angle of another one
    footed: bool = False  # whether feet are spheres about the toes

    @property
    def numbers(self) -> Shapes:
        """Joints, axes and toes at zero angles, joint by joint of N columns each, and postures."""
        n = self.limbs
        return {
            "joint_zero": (3, n * self.joints),
            "axis_zero": (3, n * self.joints),
            "toe_zero": (3, n),
            "posture": (self.joints, n),
            **({"slide_zero": (3, n * self.joints)} if self.slides else {}),
            **({"drive": (self.joints**2, n)} if self.follows else {}),
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
        if chain.slide_zero is not None:
            by_joint["slide_zero"] = chain.slide_zero
        drive = chain.drive
        if robot.capsules is not None:
            n, count = robot.capsules.joint.shape
            by_joint["capsule_zero"] = robot.capsules.ends.reshape(n, 2 * count, 3)
        return {
            **{name: v.transpose(2, 1, 0).reshape(3, -1) for name, v in by_joint.items()},
            "toe_zero": chain.toe_zero.T,
            "posture": chain.posture.T,
            **({} if drive is None else {"drive": drive.reshape(len(drive), -1).T}),
            **({} if robot.foot is None else {"foot": np.array([[robot.foot.radius]])}),
        }

    def at_toes(self, robot: Robot, toes: Array) -> dict[str, Array]:
        """Angles for toes (..., N, 3), the nearest there are, and what pulls them there."""
        chain = _chain(robot)
        angles = inverse(robot, toes).angles[..., 0, :, :]
        if not self.redundant:
            return {"angles": angles}
        away = (angles - chain.posture)[..., None] / chain.zero.unit[..., None] ** 2
        pull = np.linalg.pinv(np.swapaxes(chain.jacobian(angles), -1, -2)) @ away
        return {"angles": angles, "pull": pull[..., 0]}

    def motions(self, numbers: Mapping[str, Any], angles: Any) -> Any:
        """How far each joint is from zero (J, N), for angles (J, N)."""
        if not self.follows:
            return angles
        drive, count = numbers["drive"], self.joints
        return ca.vertcat(
            *(ca.sum1(drive[count * j : count * (j + 1), :] * angles) for j in range(count))
        )

    def by_angles(self, numbers: Mapping[str, Any], own: Any) -> Any:
        """What forces do to angles (J, N), of what they do to each joint (J, N)."""
        if not self.follows:
            return own
        drive, count = numbers["drive"], self.joints
        return ca.vertcat(*(ca.sum1(drive[k::count, :] * own) for k in range(count)))

    def eased(self, numbers: Mapping[str, Any], torques: Any) -> Any:
        """U^2 torques (J, N): how far springs of one and the same energy give."""
        if not self.slides:
            return torques
        n = self.limbs
        lengths = [
            ca.sum1(numbers["slide_zero"][:, j * n : (j + 1) * n] ** 2) for j in range(self.joints)
        ]
        return torques * (1 - (1 - RADIAN**2) * ca.vertcat(*lengths))

    def pose(self, numbers: Mapping[str, Any], angles: Any) -> StatedPose:
        """The chains for angles (J, N)."""
        n, moved = self.limbs, self.motions(numbers, angles)
        at, axis, slide = (
            [numbers[name][:, j * n : (j + 1) * n] for j in range(self.joints)] if there else []
            for name, there in (
                ("joint_zero", True), ("axis_zero", True), ("slide_zero", self.slides)
            )
        )  # fmt: skip
        toe = numbers["toe_zero"]
        joints: list[Any] = []
        axes: list[Any] = []
        slides: list[Any] = []
        for j in reversed(range(self.joints)):
            # All beyond the joint turns about it, or slides along it
            along = slide[j] * ca.repmat(moved[j, :], 3, 1) if slide else 0
            toe, *joints = [
                at[j] + _turned(axis[j], moved[j, :], p - at[j]) + along for p in (toe, *joints)
            ]
            joints = [at[j], *joints]
            axes = [axis[j]] + [_turned(axis[j], moved[j, :], a) for a in axes]
            if slide:
                slides = [slide[j]] + [_turned(axis[j], moved[j, :], a) for a in slides]
        return StatedPose(joints, axes, slides, toe)

    def points(self, numbers: Mapping[str, Any], angles: Any) -> list[Any]:
        """Joints and toe (3, N), body frame, for angles (J, N)."""
        pose = self.pose(numbers, angles)
        return [*pose.joints, pose.toe]

    def pieces(self, numbers: Mapping[str, Any], angles: Any) -> list[tuple[Any, Any]]:
        """Ends (3, N) of the axis of each capsule, body frame, for angles (J, N)."""
        if self.mounted is None:
            return list(itertools.pairwise(self.points(numbers, angles)))
        n, moved = self.limbs, self.motions(numbers, angles)
        ends = []
        for number in range(2 * len(self.mounted[0])):
            columns = []
            for i in range(n):
                point = numbers["capsule_zero"][:, number * n + i]
                for j in reversed(range(self.mounted[i][number // 2] + 1)):
                    at = numbers["joint_zero"][:, j * n + i]
                    axis = numbers["axis_zero"][:, j * n + i]
                    point = at + _turned(axis, moved[j, i], point - at)
                    if self.slides:
                        point += numbers["slide_zero"][:, j * n + i] * moved[j, i]
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
