"""Limbs that are chains of joints in programs: angles as variables, tied to the toes.

Exact forward kinematics ties them. A limb with more than three joints is redundant and takes the
angles nearest to its posture q0 (`chain_inverse.py`). Where its joints are inside their bounds the
optimality condition is q - q0 = U^2 J^T pull for some multiplier `pull` (3,), a variable too, with
the units U of angles (1 rad, or `RADIAN` of a prismatic joint). Programs therefore keep such limbs
off their joint bounds, and have the angles that the plan will have.
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
from climbplan.robots.kinematics import solve_inverse_kinematics
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.symbolic_limbs import Shapes, Tie

# Programs meet their rows up to a tolerance, and bodies that rotate between two poses leave the
# straight line. A toe in reach of a stretched limb alone is then out of reach a moment later. For
# two equal links behind two hips, a knee at the angle whose cosine is 1 - margin has a squared
# `compute_singularity_measure` of this times the margin, to first order.
_BY_KNEE = 2 / 45
_TINY = 1e-12  # keeps roots smooth


def compute_min_singularity_measure(margin: float) -> float:
    """Return the smallest admissible `compute_singularity_measure`.

    margin: off full stretch, of a knee's cosine.
    """
    return float(np.sqrt(_BY_KNEE * margin))


def compute_singularity_measure(columns: list[Any], side: Any) -> Any:
    """Return how far toes are from a singular configuration, (1, N).

    It is the root of 1 / (tr M tr M^-1), M = J J^T: the smallest singular value of J over the root
    of
    the sum of all squares, or up to a factor sqrt(3) below that. It is zero at full stretch, and
    wherever else a toe is on the border of the limb's workspace.

    Args:
        columns: Columns of J by angle, (3, N) each.
        side: Sign of det J (1, N): inverse kinematics of three joints bend one way. None for more
            joints, which bend either way.
    """
    xx, yy, zz, xy, yz, xz = (
        sum(c[a, :] * c[b, :] for c in columns)
        for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
    )
    adjugate = (yy * zz - yz**2, xx * zz - xz**2, xx * yy - xy**2)  # diagonal of M's adjugate
    size = sum(adjugate) * (xx + yy + zz)
    if side is not None:
        first, second, third = columns
        return side * ca.sum1(first * ca.cross(second, third)) / ca.sqrt(size)
    volume = xx * adjugate[0] - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)  # det M
    return ca.sqrt(volume / size + _TINY)


@dataclass(frozen=True)
class SymbolicPose:
    """Chains at given angles, body frame; lists have J entries of (3, N)."""

    joints: list[Any]
    axes: list[Any]
    slides: list[Any]  # empty where no joint slides
    toe: Any  # (3, N)

    @property
    def arms(self) -> list[Any]:
        """Toe velocity by each joint's own speed, J entries of (3, N)."""
        arms = [
            ca.cross(axis, self.toe - joint_point)
            for joint_point, axis in zip(self.joints, self.axes, strict=True)
        ]
        if not self.slides:
            return arms
        return [arm + slide for arm, slide in zip(arms, self.slides, strict=True)]


def rotate_about_axis(axis: Any, angle: Any, vector: Any) -> Any:
    """Return vectors (3, N) rotated about unit axes (3, N) by angles (1, N).

    Zero axes leave them unchanged.
    """
    cross = ca.cross(axis, vector)
    sin, versine = (ca.repmat(x, 3, 1) for x in (ca.sin(angle), 1 - ca.cos(angle)))
    return vector + sin * cross + versine * ca.cross(axis, cross)


@dataclass(frozen=True)
class ChainsAtToes:
    """N chains with angles that put their toes at points."""

    chains: SymbolicChains
    robot_parameters: Mapping[str, Any]
    toes: Any  # (3, N) body frame [m]
    angles: Any  # (J, N) [rad]
    pull: Any  # (3, N) [rad / m], or None of chains without freedom to choose
    side: Any  # (1, N) of det J, 1 or -1, or None of chains with freedom to choose

    def ties(self, margin: float) -> list[Tie]:
        """Return the rows of forward kinematics, singularity and optimality.

        Joint bounds are those of variables.
        """
        pose = self.chains.pose(self.robot_parameters, self.angles)
        ties = [Tie("kinematics.forward", pose.toe - self.toes, "m", 0.0, 0.0)]
        if margin > 0:
            measure = compute_singularity_measure(
                self.chains.columns(self.robot_parameters, pose), self.side
            )
            ties.append(
                Tie("transition.reach", measure, "", compute_min_singularity_measure(margin))
            )
        if self.pull is not None:
            scaled = self.chains.scale_by_unit(self.robot_parameters, self.torques(self.pull))
            residual = self.angles - self.robot_parameters["posture"] - scaled
            ties.append(Tie("kinematics.settled", residual, "rad", 0.0, 0.0))
        return ties

    def torques(self, force: Any, moment: Any = None) -> Any:
        """Return joint torques (J, N) of forces and moments (3, N) at the toes, body frame."""
        pose = self.chains.pose(self.robot_parameters, self.angles)
        torques = [ca.sum1(arm * force) for arm in pose.arms]
        if moment is not None:
            turning = zip(torques, pose.axes, strict=True)
            torques = [torque + ca.sum1(axis * moment) for torque, axis in turning]
        return self.chains.map_to_angles(self.robot_parameters, ca.vertcat(*torques))

    def centre(self) -> Any:
        """Return the robot's centre of mass (3, 1), body frame [m]; None if limbs weigh nothing."""
        if not self.chains.has_mass:
            return None
        carried = self.chains.accumulate_masses(self.robot_parameters, self.angles)
        return ca.sum2(carried[0][1]) + self.robot_parameters["body_middle"]

    def weight_torques(self, down: Any) -> Any:
        """Return joint torques (J, N) of the links' weight along `down` (3, 1), over the robot's.

        Body frame [m]; None where limbs weigh nothing.
        """
        if not self.chains.has_mass:
            return None
        pose = self.chains.pose(self.robot_parameters, self.angles)
        pull = ca.repmat(down, 1, self.chains.limbs)
        torques = []
        for j, (mass, moment) in enumerate(
            self.chains.accumulate_masses(self.robot_parameters, self.angles)
        ):
            weight_of_three = ca.repmat(mass, 3, 1)
            arm = ca.cross(pose.axes[j], moment - weight_of_three * pose.joints[j])
            torques.append(
                ca.sum1((arm + weight_of_three * pose.slides[j] if pose.slides else arm) * pull)
            )
        return self.chains.map_to_angles(self.robot_parameters, ca.vertcat(*torques))

    def free_toes(self, deflection: Any) -> Any:
        """Return toes (3, N) in free space, body frame, with joints back by `deflection` (J, N)."""
        return self.chains.points(self.robot_parameters, self.angles - deflection)[-1]


@dataclass(frozen=True)
class SymbolicChains:
    """N chains of up to J joints; those that a limb does not have come first and move nothing."""

    limbs: int
    joints: int
    redundant: bool  # whether a limb has more than three joints
    # (N, C) joints that move the limbs' capsules; None: links are straight from joint to joint
    mounted: tuple[tuple[int, ...], ...] | None = None
    slides: bool = False  # whether a joint does
    has_mimics: bool = False  # whether a joint moves by the angle of another one
    has_feet: bool = False  # whether feet are spheres about the toes
    has_mass: bool = False  # whether links do

    @property
    def robot_parameter_shapes(self) -> Shapes:
        """Joints, axes and toes at zero angles, joint by joint of N columns each, and postures."""
        n = self.limbs
        return {
            "joint_zero": (3, n * self.joints),
            "axis_zero": (3, n * self.joints),
            "toe_zero": (3, n),
            "posture": (self.joints, n),
            **({"slide_zero": (3, n * self.joints)} if self.slides else {}),
            **({"drive": (self.joints**2, n)} if self.has_mimics else {}),
            **({"foot": (1, 1)} if self.has_feet else {}),
            **(self._weights if self.has_mass else {}),
            **({} if self.mounted is None else {"capsule_zero": (3, 2 * n * len(self.mounted[0]))}),
        }

    @property
    def _weights(self) -> Shapes:
        """Mass fractions of links, their centres at zero angles, and the body's contribution."""
        n = self.limbs * self.joints
        return {"link_share": (1, n), "link_zero": (3, n), "body_middle": (3, 1)}

    @property
    def parameter_shapes(self) -> Shapes:
        """The sign of det J on which limbs bend (`compute_singularity_measure`)."""
        return {} if self.redundant else {"side": (1, self.limbs)}

    @property
    def variable_shapes(self) -> Shapes:
        """Angles, and the multiplier that pulls a redundant limb off its posture."""
        angles = {"angles": (self.joints, self.limbs)}
        return angles | ({"pull": (3, self.limbs)} if self.redundant else {})

    def compute_robot_parameters(self, robot: Robot) -> dict[str, Array]:
        """Return the parameters of the robot."""
        chain = _require_chain(robot)
        by_joint = {"joint_zero": chain.joint_zero, "axis_zero": chain.axis_zero}
        if chain.slide_zero is not None:
            by_joint["slide_zero"] = chain.slide_zero
        drive, links = chain.drive, robot.links
        by_link = {}
        if links is not None:
            by_joint["link_zero"] = chain.joint_zero + links.middle
            total_mass = links.mass.sum() + links.body_mass
            by_link["link_share"] = links.mass.T.reshape(1, -1) / total_mass
            by_link["body_middle"] = links.body_middle[:, None] * links.body_mass / total_mass
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
        """Return angles for toes (..., N, 3), the nearest there are, and multipliers or signs."""
        chain = _require_chain(robot)
        angles = solve_inverse_kinematics(robot, toes).angles[..., 0, :, :]
        if not self.redundant:
            side = np.where(np.linalg.det(chain.jacobian(angles)) < 0, -1.0, 1.0)
            return {"angles": angles, "side": side[..., None]}
        away = (angles - chain.posture)[..., None] / chain.zero.unit[..., None] ** 2
        pull = np.linalg.pinv(np.swapaxes(chain.jacobian(angles), -1, -2)) @ away
        return {"angles": angles, "pull": pull[..., 0]}

    def motions(self, robot_parameters: Mapping[str, Any], angles: Any) -> Any:
        """Return how far each joint is from zero (J, N), for angles (J, N)."""
        if not self.has_mimics:
            return angles
        drive, count = robot_parameters["drive"], self.joints
        return ca.vertcat(
            *(ca.sum1(drive[count * j : count * (j + 1), :] * angles) for j in range(count))
        )

    def map_to_angles(self, robot_parameters: Mapping[str, Any], by_joint: Any) -> Any:
        """Return generalised forces of angles (J, N), from those of each joint (J, N)."""
        if not self.has_mimics:
            return by_joint
        drive, count = robot_parameters["drive"], self.joints
        return ca.vertcat(*(ca.sum1(drive[k::count, :] * by_joint) for k in range(count)))

    def scale_by_unit(
        self, robot_parameters: Mapping[str, Any], torques: Any, power: int = 2
    ) -> Any:
        """Return torques (J, N) times U^power.

        With power 2 it is the deflection of springs of equal energy.
        """
        if not self.slides:
            return torques
        n = self.limbs
        lengths = [
            ca.sum1(robot_parameters["slide_zero"][:, j * n : (j + 1) * n] ** 2)
            for j in range(self.joints)
        ]
        return torques * (1 - (1 - RADIAN**power) * ca.vertcat(*lengths))

    def columns(self, robot_parameters: Mapping[str, Any], pose: SymbolicPose) -> list[Any]:
        """Return toe velocities by each angle's speed in its unit (1 rad, or `RADIAN`).

        J entries of (3, N).
        """
        by_axis = [ca.vertcat(*(arm[k, :] for arm in pose.arms)) for k in range(3)]  # (J, N) each
        scaled = [
            self.scale_by_unit(robot_parameters, self.map_to_angles(robot_parameters, rows), 1)
            for rows in by_axis
        ]
        return [ca.vertcat(*(rows[j, :] for rows in scaled)) for j in range(self.joints)]

    def pose(self, robot_parameters: Mapping[str, Any], angles: Any) -> SymbolicPose:
        """Return the chains for angles (J, N)."""
        n, motion = self.limbs, self.motions(robot_parameters, angles)
        points, axis, slide = (
            [robot_parameters[name][:, j * n : (j + 1) * n] for j in range(self.joints)]
            if has_them
            else []
            for name, has_them in (
                ("joint_zero", True), ("axis_zero", True), ("slide_zero", self.slides)
            )
        )  # fmt: skip
        toe = robot_parameters["toe_zero"]
        joints: list[Any] = []
        axes: list[Any] = []
        slides: list[Any] = []
        for j in reversed(range(self.joints)):
            # All beyond the joint turns about it, or slides along it
            shift = slide[j] * ca.repmat(motion[j, :], 3, 1) if slide else 0
            toe, *joints = [
                points[j] + rotate_about_axis(axis[j], motion[j, :], p - points[j]) + shift
                for p in (toe, *joints)
            ]
            joints = [points[j], *joints]
            axes = [axis[j]] + [rotate_about_axis(axis[j], motion[j, :], a) for a in axes]
            if slide:
                slides = [slide[j]] + [rotate_about_axis(axis[j], motion[j, :], a) for a in slides]
        return SymbolicPose(joints, axes, slides, toe)

    def accumulate_masses(
        self, robot_parameters: Mapping[str, Any], angles: Any
    ) -> list[tuple[Any, Any]]:
        """Return by joint the mass fraction (1, N) beyond it, and that times its centre (3, N).

        Body frame, for angles (J, N).
        """
        n, motion = self.limbs, self.motions(robot_parameters, angles)
        beyond_joint: list[tuple[Any, Any]] = []
        for j in reversed(range(self.joints)):
            point, axis, zero, fraction = (
                robot_parameters[name][:, j * n : (j + 1) * n]
                for name in ("joint_zero", "axis_zero", "link_zero", "link_share")
            )
            link_moment = ca.repmat(fraction, 3, 1) * zero
            beyond = beyond_joint[0] if beyond_joint else (0, 0)
            beyond_joint = [(fraction + beyond[0], link_moment + beyond[1]), *beyond_joint]
            for k, (mass, moment) in enumerate(beyond_joint):
                weights = ca.repmat(mass, 3, 1)
                moved_moment = weights * point + rotate_about_axis(
                    axis, motion[j, :], moment - weights * point
                )
                if self.slides:
                    moved_moment += (
                        weights
                        * robot_parameters["slide_zero"][:, j * n : (j + 1) * n]
                        * ca.repmat(motion[j, :], 3, 1)
                    )
                beyond_joint[k] = mass, moved_moment
        return beyond_joint

    def points(self, robot_parameters: Mapping[str, Any], angles: Any) -> list[Any]:
        """Return joints and toe (3, N), body frame, for angles (J, N)."""
        pose = self.pose(robot_parameters, angles)
        return [*pose.joints, pose.toe]

    def pieces(self, robot_parameters: Mapping[str, Any], angles: Any) -> list[tuple[Any, Any]]:
        """Return ends (3, N) of the axis of each capsule, body frame, for angles (J, N)."""
        if self.mounted is None:
            return list(itertools.pairwise(self.points(robot_parameters, angles)))
        n, motion = self.limbs, self.motions(robot_parameters, angles)
        ends = []
        for number in range(2 * len(self.mounted[0])):
            columns = []
            for i in range(n):
                point = robot_parameters["capsule_zero"][:, number * n + i]
                for j in reversed(range(self.mounted[i][number // 2] + 1)):
                    origin = robot_parameters["joint_zero"][:, j * n + i]
                    axis = robot_parameters["axis_zero"][:, j * n + i]
                    point = origin + rotate_about_axis(axis, motion[j, i], point - origin)
                    if self.slides:
                        point += robot_parameters["slide_zero"][:, j * n + i] * motion[j, i]
                columns.append(point)
            ends.append(ca.horzcat(*columns))
        return list(zip(ends[::2], ends[1::2], strict=True))

    def standing(
        self, robot_parameters: Mapping[str, Any], toes: Any, values: Mapping[str, Any]
    ) -> ChainsAtToes:
        """Return chains with toes (3, N) in the body frame."""
        return ChainsAtToes(
            self, robot_parameters, toes, values["angles"], values.get("pull"), values.get("side")
        )


def _require_chain(robot: Robot) -> SerialChain:
    """Return the chains of the robot."""
    if not isinstance(robot.mechanism, SerialChain):
        raise TypeError("expected a robot whose limbs are chains")
    return robot.mechanism
