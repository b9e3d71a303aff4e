"""A plan's tables for the regulator from joint angles, `control/joint_regulator.py`.

The regulator computes toes of serial limbs by its own kinematics. For five-bar legs those of the
robot are used.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.simulation.control.odometry import find_trusted_toes
from climbplan.climb.simulation.control.steady_rate import compute_stable_rates
from climbplan.control.joint_regulator import (
    BodyPoseEstimate,
    Corrections,
    RegulatorTables,
    build_chains,
)
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.chain_pose import ChainZero
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import jacobian_world, rigid_motion, toe_body, toe_world
from climbplan.robots.last_link import last_link_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.measures import integrate_rolling

# By the largest singular value: smaller singular values are damped, as toes of limbs that are
# nearly straight move on arcs
MIN_SINGULAR_RATIO = 0.05
MAX_STIFFNESS = 1e5  # [N/m] of a limb at most


def build_regulator_tables(plan: ClimbPlan, gain: Array | None = None) -> RegulatorTables:
    """Build the tables of a plan that the regulator reads.

    Args:
        plan: The plan.
        gain: (N, J) proportional gains of the controller [N m/rad]. Commands are scaled for them,
            so that joints exert the same torques at the same angles. None takes those of the robot.
    """
    trajectory, robot = plan.trajectory, plan.robot
    angles = compute_true_angles(plan, sample_instants(plan))
    total_compliance = joint_softness(robot)
    structural_compliance = total_compliance - 1 / robot.joint_stiffness
    gain = robot.joint_stiffness if gain is None else gain
    compliance_with_gain = structural_compliance + 1 / gain
    max_deflection = compliance_with_gain * robot.max_torque
    command = angles + (trajectory.joint_command - angles) * (
        compliance_with_gain / total_compliance
    )
    jacobian = jacobian_world(robot, trajectory.rpy, angles)
    compliance = (jacobian * compliance_with_gain[:, None, :]) @ np.swapaxes(jacobian, -1, -2)
    arms = toe_world(robot, trajectory.com, trajectory.rpy, angles) - trajectory.com[:, None]
    trusted = find_trusted_toes(plan)
    zero_pose = compute_zero_pose(robot)
    n, joints = robot.limb_count, robot.joint_count
    return RegulatorTables(
        time=trajectory.time,
        command=command,
        com=trajectory.com,
        rotation=rotation_world_body(trajectory.rpy),
        contact=trajectory.contact.astype(float),
        trusted=trusted.astype(float),
        settled=(trusted == trajectory.contact).all(axis=1).astype(float),
        jacobian=np.ascontiguousarray(jacobian),
        turning=invert_jacobian(jacobian),
        arms=np.ascontiguousarray(arms),
        internal_projector=np.ascontiguousarray(
            build_internal_projector(compliance, arms, trajectory.contact)
        ),
        deflection=np.clip(angles - command, -max_deflection, max_deflection),
        max_deflection=np.broadcast_to(max_deflection, (n, joints)).copy(),
        compliance_ratio=np.broadcast_to(compliance_with_gain * gain, (n, joints)).copy(),
        rate=compute_stable_rates(plan),
        toes=plan.rounds.toes[0].copy(),
        rolled=_compute_rolling(plan, angles),
        axis_zero=np.zeros((n, joints, 3)) if zero_pose is None else zero_pose.axes,
        joint_zero=np.zeros((n, joints, 3)) if zero_pose is None else zero_pose.joints,
        toe_zero=np.zeros((n, 3)) if zero_pose is None else zero_pose.toe,
        slide_zero=_use_default(
            None if zero_pose is None else zero_pose.slides, np.zeros((n, joints, 3))
        ),
        drive=_use_default(
            None if zero_pose is None else zero_pose.drive, np.tile(np.eye(joints), (n, 1, 1))
        ),
    )


def invert_jacobian(jacobian: Array) -> Array:
    """Compute damped pseudoinverses (..., J, 3) of Jacobians (..., 3, J) [rad/m].

    Singular values s below a limit e are inverted to s / e^2 instead of 1 / s (numerical filtering,
    Maciejewski and Klein 1988), which is continuous. Without damping a millimetre in the direction
    of a nearly straight limb would need half a radian and bring the toe off its wall.
    """
    left, value, right = np.linalg.svd(jacobian, full_matrices=False)
    min_value = MIN_SINGULAR_RATIO * value[..., :1]
    gain = value / np.maximum(np.maximum(value, min_value) ** 2, np.finfo(float).tiny)
    return np.ascontiguousarray(
        np.swapaxes(right, -1, -2) * gain[..., None, :] @ np.swapaxes(left, -1, -2)
    )


def _compute_rolling(plan: ClimbPlan, angles: Array) -> Array:
    """Compute how far centers (T, N, 3) of standing spherical feet roll [m], at angles (T, N, J).

    Plans keep the centers fixed, so the displacement accumulates over the steps of a walk.
    """
    robot, trajectory = plan.robot, plan.trajectory
    rolling = np.zeros((len(angles), robot.limb_count, 3))
    if robot.foot is None or robot.sole is not None:
        return rolling
    instant = np.maximum(sample_instants(plan), 0)
    normal = plan.instants.normal[instant]  # (T, N, 3)
    rotation = rotation_world_body(trajectory.rpy)[:, None]
    links = rotation @ np.swapaxes(last_link_body(robot, angles), -1, -2)
    for limb in range(robot.limb_count):
        for first, last in spans_of(trajectory.contact[:, limb]):
            displacement = integrate_rolling(
                robot.foot.radius, links[first:last, limb], normal[last - 1, limb]
            )
            rolling[first:last, limb] = rolling[max(first - 1, 0), limb] + displacement
            rolling[last:, limb] = rolling[last - 1, limb]
    return rolling


def _use_default(value: Array | None, default: Array) -> Array:
    return default if value is None else value


class Regulator(Corrections):
    """Corrections of a plan's commands by poses and joints of a simulation."""

    def __init__(self, plan: ClimbPlan, correct_position: bool) -> None:
        super().__init__(build_regulator_tables(plan), correct_position)

    def compute_correction(
        self, sample: float, seconds: float, pose: tuple[Array, Array], lag: Array
    ) -> Array:
        """Compute corrections (N, J) of the joint commands [rad]; a copy of what `update` returns.

        Args:
            sample: Sample of the trajectory, with a fraction.
            seconds: Time since the last call [s].
            pose: Position (3,) and rotation (3, 3) of the body to the world.
            lag: (N, J) joint angles less commands, without gravity feedforward [rad].
        """
        return self.update(sample, seconds, *pose, lag).copy()


class JointOdometry:
    """The body's pose from joint angles, sample by sample."""

    def __init__(
        self, plan: ClimbPlan, toes: Array | None = None, tables: RegulatorTables | None = None
    ) -> None:
        """Initialise the pose estimate.

        Args:
            plan: The plan.
            toes: (N, 3) estimated places of toes at the start; None takes the planned ones.
            tables: The regulator's tables; None builds them.
        """
        tables = build_regulator_tables(plan) if tables is None else tables
        self._robot = plan.robot
        has_linkage = isinstance(plan.robot.mechanism, FiveBar)
        self._chains = None if has_linkage else build_chains(tables)
        self._pose = BodyPoseEstimate(tables, toes)

    def pose(self, sample: int, angles: Array) -> tuple[Array, Array]:
        """Estimate position and rotation to the world from angles (N, J) at a sample."""
        chains = self._chains
        toes = toe_body(self._robot, angles) if chains is None else chains.place(angles)
        self._pose.update(sample, toes)
        return self._pose.com, self._pose.rotation


def compute_zero_pose(robot: Robot) -> ChainZero | None:
    """Compute axes, joints and toes of all limbs at zero angles; None for five-bar legs."""
    if isinstance(robot.mechanism, FiveBar):
        return None
    if isinstance(robot.mechanism, SerialChain):
        return robot.mechanism.zero
    # The femur outward, the tibia straight down
    yaw = robot.mount_yaw
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(yaw), 3))
    outward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    lift = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=-1)
    first, second, third = (robot.link_lengths[:, j : j + 1] for j in range(3))
    femur = robot.shoulder_body + first * outward
    knee = femur + second * outward
    return ChainZero(
        np.stack([robot.shoulder_body, femur, knee], axis=1),
        np.stack([up, lift, lift], axis=1),
        knee - third * up,
    )


def build_internal_projector(compliance: Array, arms: Array, contact: BoolArray) -> Array:
    """Build the projector (..., 3N, 3N) of toe deflections onto those without body motion.

    It is I - B A^-1 B^T K with toe motion B of the body, limb stiffness K and A = B^T K B: the body
    motion that balances the forces K d is removed. Of motions that toes in a line leave
    undetermined the smallest counts.

    Args:
        compliance: (..., N, 3, 3) of the limbs [m/N].
        arms: (..., N, 3) from body to toes [m].
        contact: (..., N) bool, toe is in contact; others have no part in it.
    """
    in_contact = contact[..., None, None]
    stiffness = np.linalg.inv(compliance + np.eye(3) / MAX_STIFFNESS) * in_contact
    motion = rigid_motion(arms) * in_contact
    weighted = np.swapaxes(motion, -1, -2) @ stiffness  # (..., N, 6, 3)
    body = np.linalg.pinv((weighted @ motion).sum(axis=-3), rcond=1e-6, hermitian=True)
    size = 3 * arms.shape[-2]
    body_part = np.einsum("...iax,...xy,...jyb->...iajb", motion, body, weighted)
    standing_rows = np.repeat(contact, 3, axis=-1)[..., None]
    return np.asarray(
        np.eye(size) * standing_rows - body_part.reshape(*arms.shape[:-2], size, size)
    )
