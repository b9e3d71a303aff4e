"""A plan's tables for the regulator from joint angles, `control/joint_regulator.py`.

Where toes are found by the angles of serial limbs the regulator's own chains place them, those of
five-bar legs the robot's kinematics.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants, true_angles
from climbplan.climb.simulation.control.odometry import standing
from climbplan.climb.simulation.control.steady_rate import steady_rates
from climbplan.control.joint_regulator import Corrections, Pose, RegulatorTables, chains_of
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.chain_pose import ChainZero
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import jacobian_world, rigid_motion, toe_body, toe_world
from climbplan.robots.last_link import last_link_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.measures import rolled

# Of a Jacobian's largest singular value: along limbs that are stretched farther toes move on arcs
STRETCHED = 0.05
STIFFEST = 1e5  # [N/m] that a limb counts for at most


def regulator_tables(plan: ClimbPlan, gain: Array | None = None) -> RegulatorTables:
    """What the regulator reads of a plan.

    gain: (N, J) P gains of the controller [N m/rad], for which commands are made anew so that
    joints bring the same torques at the same angles; those of the robot if left out.
    """
    moving, robot = plan.trajectory, plan.robot
    angles = true_angles(plan, sample_instants(plan))
    soft = joint_softness(robot)
    structure = soft - 1 / robot.joint_stiffness
    gain = robot.joint_stiffness if gain is None else gain
    softness = structure + 1 / gain
    most = softness * robot.max_torque
    command = angles + (moving.joint_command - angles) * (softness / soft)
    jacobian = jacobian_world(robot, moving.rpy, angles)
    compliance = (jacobian * softness[:, None, :]) @ np.swapaxes(jacobian, -1, -2)
    arms = toe_world(robot, moving.com, moving.rpy, angles) - moving.com[:, None]
    trusted = standing(plan)
    zero = zero_angles(robot)
    n, joints = robot.limb_count, robot.joint_count
    return RegulatorTables(
        time=moving.time,
        command=command,
        com=moving.com,
        rotation=rotation_world_body(moving.rpy),
        contact=moving.contact.astype(float),
        trusted=trusted.astype(float),
        settled=(trusted == moving.contact).all(axis=1).astype(float),
        jacobian=np.ascontiguousarray(jacobian),
        turning=turning_of(jacobian),
        arms=np.ascontiguousarray(arms),
        sharing=np.ascontiguousarray(between_toes(compliance, arms, moving.contact)),
        bent=np.clip(angles - command, -most, most),
        most=np.broadcast_to(most, (n, joints)).copy(),
        give=np.broadcast_to(softness * gain, (n, joints)).copy(),
        rate=steady_rates(plan),
        toes=plan.rounds.toes[0].copy(),
        rolled=_rolled(plan, angles),
        axis_zero=np.zeros((n, joints, 3)) if zero is None else zero.axes,
        joint_zero=np.zeros((n, joints, 3)) if zero is None else zero.joints,
        toe_zero=np.zeros((n, 3)) if zero is None else zero.toe,
        slide_zero=_or(None if zero is None else zero.slides, np.zeros((n, joints, 3))),
        drive=_or(None if zero is None else zero.drive, np.tile(np.eye(joints), (n, 1, 1))),
    )


def turning_of(jacobian: Array) -> Array:
    """(..., J, 3) joint turns [rad/m] that move toes, of Jacobians (..., 3, J).

    The inverse of least turns; in directions in which a limb is nearly at full stretch damped
    (numerical filtering: Maciejewski and Klein 1988), and without a jump: singular values s below e
    turn joints by s / e^2 and not by 1 / s. There a millimetre would ask for half a radian, which
    brings the knee through its stretch and the toe off its wall.
    """
    left, value, right = np.linalg.svd(jacobian, full_matrices=False)
    least = STRETCHED * value[..., :1]
    gain = value / np.maximum(np.maximum(value, least) ** 2, np.finfo(float).tiny)
    return np.ascontiguousarray(
        np.swapaxes(right, -1, -2) * gain[..., None, :] @ np.swapaxes(left, -1, -2)
    )


def _rolled(plan: ClimbPlan, angles: Array) -> Array:
    """(T, N, 3) how far centres of spherical feet roll on that stand [m], at angles (T, N, J).

    Plans hold them where they are: left out there, it adds up over the steps of a walk.
    """
    robot, moving = plan.robot, plan.trajectory
    out = np.zeros((len(angles), robot.limb_count, 3))
    if robot.foot is None or robot.sole is not None:
        return out
    instant = np.maximum(sample_instants(plan), 0)
    normal = plan.instants.normal[instant]  # (T, N, 3)
    rotation = rotation_world_body(moving.rpy)[:, None]
    links = rotation @ np.swapaxes(last_link_body(robot, angles), -1, -2)
    for limb in range(robot.limb_count):
        for first, last in spans_of(moving.contact[:, limb]):
            moved = rolled(robot.foot.radius, links[first:last, limb], normal[last - 1, limb])
            out[first:last, limb] = out[max(first - 1, 0), limb] + moved
            out[last:, limb] = out[last - 1, limb]
    return out


def _or(given: Array | None, otherwise: Array) -> Array:
    return otherwise if given is None else given


class Regulator(Corrections):
    """Corrections of a plan's commands by poses and joints of a simulation."""

    def __init__(self, plan: ClimbPlan, place: bool) -> None:
        super().__init__(regulator_tables(plan), place)

    def correction(
        self, sample: float, seconds: float, pose: tuple[Array, Array], lag: Array
    ) -> Array:
        """(N, J) what to add to the joint commands [rad], as `update`, to keep."""
        return self.update(sample, seconds, *pose, lag).copy()


class JointOdometry:
    """The body's pose from joint angles, sample by sample."""

    def __init__(
        self, plan: ClimbPlan, toes: Array | None = None, tables: RegulatorTables | None = None
    ) -> None:
        """toes: (N, 3) where they stand at the start, as far as the robot knows; as planned."""
        tables = regulator_tables(plan) if tables is None else tables
        self._robot = plan.robot
        own = isinstance(plan.robot.mechanism, FiveBar)
        self._chains = None if own else chains_of(tables)
        self._pose = Pose(tables, toes)

    def pose(self, sample: int, angles: Array) -> tuple[Array, Array]:
        """Position and rotation to the world, by angles (N, J) at a sample of the trajectory."""
        chains = self._chains
        toes = toe_body(self._robot, angles) if chains is None else chains.place(angles)
        self._pose.update(sample, toes)
        return self._pose.com, self._pose.rotation


def zero_angles(robot: Robot) -> ChainZero | None:
    """Axes, joints and toes of all limbs at zero angles; None for five-bar legs."""
    if isinstance(robot.mechanism, FiveBar):
        return None
    if isinstance(robot.mechanism, SerialChain):
        return robot.mechanism.zero
    # The femur outward, the tibia straight down
    yaw = robot.mount_yaw
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(yaw), 3))
    out = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    lift = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=-1)
    first, second, third = (robot.link_lengths[:, j : j + 1] for j in range(3))
    femur = robot.shoulder_body + first * out
    knee = femur + second * out
    return ChainZero(
        np.stack([robot.shoulder_body, femur, knee], axis=1),
        np.stack([up, lift, lift], axis=1),
        knee - third * up,
    )


def between_toes(compliance: Array, arms: Array, stands: BoolArray) -> Array:
    """(..., 3N, 3N) of toe deflections (..., 3N) the part that no motion of the body explains.

    I - B A^-1 B^T K: the motion that balances the forces K d is taken out. compliance: (..., N, 3,
    3) [m/N]; arms: (..., N, 3) from body to toes; stands: (..., N). Of the motions that toes in a
    line leave open the least counts. Toes in the air have no part in it.
    """
    there = stands[..., None, None]
    stiffness = np.linalg.inv(compliance + np.eye(3) / STIFFEST) * there
    motion = rigid_motion(arms) * there
    pulls = np.swapaxes(motion, -1, -2) @ stiffness  # (..., N, 6, 3)
    body = np.linalg.pinv((pulls @ motion).sum(axis=-3), rcond=1e-6, hermitian=True)
    size = 3 * arms.shape[-2]
    taken = np.einsum("...iax,...xy,...jyb->...iajb", motion, body, pulls)
    standing = np.repeat(stands, 3, axis=-1)[..., None]
    return np.asarray(np.eye(size) * standing - taken.reshape(*arms.shape[:-2], size, size))
