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

from climbplan.arrays import Array
from climbplan.robots.chain_pose import RADIAN
from climbplan.robots.kinematics import inverse
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.stated_limbs import Shapes, Tie

# How far chains are bent off full stretch: programs meet their rows up to a tolerance, and bodies
# that turn between two poses leave the straight way, so that toes that a stretched limb alone
# reaches are out of reach a moment later. Of two equal links behind two hips, a knee bent by the
# angle whose cosine is 1 - room has the square of `bent_by` at this times room, to first order.
_BY_KNEE = 2 / 45
_TINY = 1e-12  # keeps roots smooth


def least_bent(room: float) -> float:
    """What `bent_by` is to be at least, `room` off full stretch of a knee's cosine."""
    return float(np.sqrt(_BY_KNEE * room))


def bent_by(columns: list[Any], side: Any) -> Any:
    """(1, N) how far toes are from where they could not move on in some direction.

    columns: (3, N) by angle, of J. The root of 1 / (tr M tr M^-1), M = J J^T: the least singular
    value of J over the root of the sum of all squares, or up to a root of three below that. Zero at
    full stretch, and wherever else a toe is on the border of what a limb inside its joint bounds
    reaches. side: (1, N) of det J, below zero on the other: inverse kinematics of three joints
    bend one way; None: of more joints, which bend any way.
    """
    xx, yy, zz, xy, yz, xz = (
        sum(c[a, :] * c[b, :] for c in columns)
        for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
    )
    across = (yy * zz - yz**2, xx * zz - xz**2, xx * yy - xy**2)  # diagonal of M's adjugate
    size = sum(across) * (xx + yy + zz)
    if side is not None:
        one, two, three = columns
        return side * ca.sum1(one * ca.cross(two, three)) / ca.sqrt(size)
    volume = xx * across[0] - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)  # det M
    return ca.sqrt(volume / size + _TINY)


@dataclass(frozen=True)
class StatedPose:
    """Chains at given angles, body frame; lists have J entries of (3, N)."""

    joints: list[Any]
    axes: list[Any]
    slides: list[Any]  # empty where no joint slides
    toe: Any  # (3, N)

    @property
    def arms(self) -> list[Any]:
        """Toe velocity by each joint's own speed, J entries of (3, N)."""
        arms = [
            ca.cross(axis, self.toe - at) for at, axis in zip(self.joints, self.axes, strict=True)
        ]
        if not self.slides:
            return arms
        return [arm + slide for arm, slide in zip(arms, self.slides, strict=True)]


def turned_about(axis: Any, angle: Any, vector: Any) -> Any:
    """Vectors (3, N) turned about unit axes (3, N) by angles (1, N); the same where axes are 0."""
    once = ca.cross(axis, vector)
    sin, rest = (ca.repmat(x, 3, 1) for x in (ca.sin(angle), 1 - ca.cos(angle)))
    return vector + sin * once + rest * ca.cross(axis, once)


@dataclass(frozen=True)
class ChainsAtToes:
    """N chains with angles that are to put their toes at points."""

    stated: StatedChains
    numbers: Mapping[str, Any]
    toes: Any  # (3, N) body frame [m]
    angles: Any  # (J, N) [rad]
    pull: Any  # (3, N) [rad / m], or None of chains without freedom to choose
    side: Any  # (1, N) of det J, 1 or -1, or None of chains with freedom to choose

    def ties(self, room: float) -> list[Tie]:
        """Forward kinematics, bent enough, and nothing left to choose.

        Joint bounds are those of variables.
        """
        pose = self.stated.pose(self.numbers, self.angles)
        ties = [Tie("kinematics.toes", pose.toe - self.toes, "m", 0.0, 0.0)]
        if room > 0:
            bent = bent_by(self.stated.columns(self.numbers, pose), self.side)
            ties.append(Tie("transition.reach", bent, "", least_bent(room)))
        if self.pull is not None:
            eased = self.stated.eased(self.numbers, self.torques(self.pull))
            off = self.angles - self.numbers["posture"] - eased
            ties.append(Tie("kinematics.settled", off, "rad", 0.0, 0.0))
        return ties

    def torques(self, force: Any, moment: Any = None) -> Any:
        """Joint torques (J, N) of forces (3, N) on the toes and moments about them, body frame."""
        pose = self.stated.pose(self.numbers, self.angles)
        torques = [ca.sum1(arm * force) for arm in pose.arms]
        if moment is not None:
            turning = zip(torques, pose.axes, strict=True)
            torques = [torque + ca.sum1(axis * moment) for torque, axis in turning]
        return self.stated.by_angles(self.numbers, ca.vertcat(*torques))

    def centre(self) -> Any:
        """(3, 1) centre of mass of the robot, body frame [m]; None where limbs weigh nothing."""
        if not self.stated.weighs:
            return None
        carried = self.stated.carried(self.numbers, self.angles)
        return ca.sum2(carried[0][1]) + self.numbers["body_middle"]

    def weight_torques(self, down: Any) -> Any:
        """Joint torques (J, N) of links that pull along `down` (3, 1), over the robot's weight.

        Body frame [m]; None where limbs weigh nothing.
        """
        if not self.stated.weighs:
            return None
        pose = self.stated.pose(self.numbers, self.angles)
        pull = ca.repmat(down, 1, self.stated.limbs)
        own = []
        for j, (mass, moment) in enumerate(self.stated.carried(self.numbers, self.angles)):
            three = ca.repmat(mass, 3, 1)
            arm = ca.cross(pose.axes[j], moment - three * pose.joints[j])
            own.append(ca.sum1((arm + three * pose.slides[j] if pose.slides else arm) * pull))
        return self.stated.by_angles(self.numbers, ca.vertcat(*own))

    def free_toes(self, bent: Any) -> Any:
        """Where toes (3, N) would be in free space, body frame, with joints `bent` (J, N) back."""
        return self.stated.points(self.numbers, self.angles - bent)[-1]


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
    weighs: bool = False  # whether links do

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
            **(self._weights if self.weighs else {}),
            **({} if self.mounted is None else {"capsule_zero": (3, 2 * n * len(self.mounted[0]))}),
        }

    @property
    def _weights(self) -> Shapes:
        """Shares of the mass in links, their centres at zero angles, and what the body adds."""
        n = self.limbs * self.joints
        return {"link_share": (1, n), "link_zero": (3, n), "body_middle": (3, 1)}

    @property
    def given(self) -> Shapes:
        """On which side of full stretch, and of other singular angles, limbs bend (`bent_by`)."""
        return {} if self.redundant else {"side": (1, self.limbs)}

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
        drive, links = chain.drive, robot.links
        by_link = {}
        if links is not None:
            by_joint["link_zero"] = chain.joint_zero + links.middle
            whole = links.mass.sum() + links.body_mass
            by_link["link_share"] = links.mass.T.reshape(1, -1) / whole
            by_link["body_middle"] = links.body_middle[:, None] * links.body_mass / whole
        if robot.capsules is not None:
            n, count = robot.capsules.joint.shape
            by_joint["capsule_zero"] = robot.capsules.ends.reshape(n, 2 * count, 3)
        return {
            **{name: v.transpose(2, 1, 0).reshape(3, -1) for name, v in by_joint.items()},
            **by_link,
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
            side = np.where(np.linalg.det(chain.jacobian(angles)) < 0, -1.0, 1.0)
            return {"angles": angles, "side": side[..., None]}
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

    def eased(self, numbers: Mapping[str, Any], torques: Any, power: int = 2) -> Any:
        """U^2 torques (J, N): how far springs of one and the same energy give; or U to a power."""
        if not self.slides:
            return torques
        n = self.limbs
        lengths = [
            ca.sum1(numbers["slide_zero"][:, j * n : (j + 1) * n] ** 2) for j in range(self.joints)
        ]
        return torques * (1 - (1 - RADIAN**power) * ca.vertcat(*lengths))

    def columns(self, numbers: Mapping[str, Any], pose: StatedPose) -> list[Any]:
        """Toe velocity by each angle's speed in its unit (1 rad, or `RADIAN`), J of (3, N)."""
        by_axis = [ca.vertcat(*(arm[k, :] for arm in pose.arms)) for k in range(3)]  # (J, N) each
        own = [self.eased(numbers, self.by_angles(numbers, rows), 1) for rows in by_axis]
        return [ca.vertcat(*(rows[j, :] for rows in own)) for j in range(self.joints)]

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
                at[j] + turned_about(axis[j], moved[j, :], p - at[j]) + along
                for p in (toe, *joints)
            ]
            joints = [at[j], *joints]
            axes = [axis[j]] + [turned_about(axis[j], moved[j, :], a) for a in axes]
            if slide:
                slides = [slide[j]] + [turned_about(axis[j], moved[j, :], a) for a in slides]
        return StatedPose(joints, axes, slides, toe)

    def carried(self, numbers: Mapping[str, Any], angles: Any) -> list[tuple[Any, Any]]:
        """By joint the share (1, N) of the mass beyond it, and that times its centre (3, N).

        Body frame, for angles (J, N).
        """
        n, moved = self.limbs, self.motions(numbers, angles)
        out: list[tuple[Any, Any]] = []
        for j in reversed(range(self.joints)):
            at, axis, zero, share = (
                numbers[name][:, j * n : (j + 1) * n]
                for name in ("joint_zero", "axis_zero", "link_zero", "link_share")
            )
            own = ca.repmat(share, 3, 1) * zero
            beyond = out[0] if out else (0, 0)
            out = [(share + beyond[0], own + beyond[1]), *out]
            for k, (mass, moment) in enumerate(out):
                three = ca.repmat(mass, 3, 1)
                turned = three * at + turned_about(axis, moved[j, :], moment - three * at)
                if self.slides:
                    turned += (
                        three
                        * numbers["slide_zero"][:, j * n : (j + 1) * n]
                        * ca.repmat(moved[j, :], 3, 1)
                    )
                out[k] = mass, turned
        return out

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
                    point = at + turned_about(axis, moved[j, i], point - at)
                    if self.slides:
                        point += numbers["slide_zero"][:, j * n + i] * moved[j, i]
                columns.append(point)
            ends.append(ca.horzcat(*columns))
        return list(zip(ends[::2], ends[1::2], strict=True))

    def standing(
        self, numbers: Mapping[str, Any], toes: Any, own: Mapping[str, Any]
    ) -> ChainsAtToes:
        """Chains with toes (3, N) in the body frame."""
        return ChainsAtToes(self, numbers, toes, own["angles"], own.get("pull"), own.get("side"))


def _chain(robot: Robot) -> SerialChain:
    if not isinstance(robot.mechanism, SerialChain):
        raise TypeError("expected a robot whose limbs are chains")
    return robot.mechanism
