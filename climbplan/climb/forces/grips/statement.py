"""The force problem of robots with grippers, as arrays.

For every limb in contact the unknowns are the forces p, r+, r- on palm and fingers, of which
contact force f, moment m and gripping force g are linear (`mechanics.grip`):

    minimise    s = 1 / S_tau
    such that   sum f_i + F = 0, sum h_i x f_i + m_i + M = 0      equilibrium, at the grips h_i
                |tau_i| <= s max_torque                           torque of the limb's joints
                |axes_i (m_i - d n_i x f_i)| <= s wrist torque    torque of its wrist
                0 <= g_i <= s max_force                           gripping force
                palm and fingers within their cones               friction and spines
                fingers within them still when pulled further     margin (`margins`), without S_mu
                lower <= theta - tau / k <= upper                 command

with tau = J^T f + (joint axes) . (m - d n x f) at the wrist's centre, d the gripper's length. All
of it is linear or a second-order cone. Wrists hold their torque by the force sensors in them, the
limb's joints are springs about their commands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.mechanics.equilibrium import link_torques, total_load
from climbplan.mechanics.grip import FIRST, SECOND, GripCones, Grippers, grip_cones
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.gripper import Gripper, Wrists, wrists_at
from climbplan.robots.kinematics import jacobian_world
from climbplan.robots.last_link import joint_axes_body, last_link_body
from climbplan.robots.rotations import rotation_world_body, skew

RESIDUAL_LIMIT = 1e-7  # of accepted forces, in units of the load


@dataclass(frozen=True)
class GripStatement:
    """Numbers of the force problems of K instants."""

    gripper: Gripper
    contact: BoolArray  # (K, N)
    load: Array  # (K, 6) on the body [N, N m]
    normal: Array  # (K, N, 3)
    axis: Array  # (K, N, 3) from one finger to the other
    arms: Array  # (K, N, 3) from the body origin to the grips [m]
    cones: GripCones  # (K, N, ...)
    jacobian: Array  # (K, N, 3, 3) of the wrists' centres, world frame [m/rad]
    torque: Array  # (K, N, 3, 6) joint torques by force and moment at the grip
    wrist: Array  # (K, N, 3, 6) wrist torques likewise
    wrists: Wrists  # (K, N, ...)
    joint_angles: Array  # (K, N, 3) [rad]
    softness: Array  # (N, 3) [rad/(N m)]
    margin_below: Array  # (K, N, 3) from the lower joint bound to the joint angle [rad]
    margin_above: Array  # (K, N, 3)
    max_torque: Array  # (N, 3) [N m]
    link_torques: Array  # (K, N, 3) of the links' own weight [N m]
    safety_friction: Array  # (K,) S_mu, or more where holds may lack friction
    pull: Array  # (K,) further pull that every grip holds [N]
    min_safety_torque: float
    unit: float  # force scale [N]
    length: float  # lever arm scale [m]

    @property
    def max_s(self) -> float:
        """Return the upper bound of s."""
        return 1 / self.min_safety_torque

    def build_wrench_map(self, k: int, limb: int) -> Array:
        """Return the map (7, 9) from forces on palm and fingers to force, moment and gripping
        force.
        """
        axis, half = self.axis[k, limb], self.gripper.finger_span / 2
        wrench_map = np.zeros((7, 3, 3))
        wrench_map[:3] = np.eye(3)[:, None, :]
        wrench_map[3:6, FIRST], wrench_map[3:6, SECOND] = half * skew(axis), -half * skew(axis)
        wrench_map[6, FIRST], wrench_map[6, SECOND] = axis / 2, -axis / 2
        return wrench_map.reshape(7, 9)


def compute_grip_wrists(scene: MotionScene, instants: Instants, grippers: Grippers) -> Wrists:
    """Return wrists (K, N, ...) that hold the grippers square on their holds, lifted ones too."""
    rotation = rotation_world_body(instants.rpy)
    link = np.einsum("kab,knib->knia", rotation, last_link_body(scene.robot, instants.joint_angles))
    return wrists_at(link, -instants.normal, grippers.axis[instants.region])


def build_grip_statement(
    scene: MotionScene, instants: Instants, grippers: Grippers
) -> GripStatement:
    """Return the force problems of a scene's instants."""
    robot, force, gripper = scene.robot, scene.spec.force, grippers.gripper
    region, normal = instants.region, instants.normal
    load = total_load(robot, instants.external_wrench, instants.rpy, instants.joint_angles)
    load_norms = np.linalg.norm(load[:, :3], axis=1)
    unit = float(load_norms.max(initial=0.0)) or float(robot.max_torque.min() / robot.reach)
    jacobian = jacobian_world(robot, instants.rpy, instants.joint_angles)
    rotation = rotation_world_body(instants.rpy)
    axes = np.einsum("kab,knib->knia", rotation, joint_axes_body(robot, instants.joint_angles))
    wrists = compute_grip_wrists(scene, instants, grippers)
    # Moment at the wrist's centre by force and moment at the grip: m - d n x f
    wrist_moment_map = np.concatenate(
        [
            -gripper.length * skew(normal),
            np.broadcast_to(np.eye(3), (*normal.shape, 3)),
        ],
        axis=-1,
    )
    torque = axes @ wrist_moment_map
    torque[..., :3] += np.swapaxes(jacobian, -1, -2)
    return GripStatement(
        gripper=gripper,
        contact=instants.contact,
        load=load,
        normal=normal,
        axis=grippers.axis[region],
        arms=instants.toes - gripper.length * normal - instants.com[:, None],
        cones=grip_cones(
            normal,
            grippers.axis[region],
            grippers.undercut[region],
            instants.mu,
            grippers.spines[region],
        ),
        jacobian=jacobian,
        torque=torque,
        wrist=wrists.axes @ wrist_moment_map,
        wrists=wrists,
        joint_angles=instants.joint_angles,
        softness=joint_softness(robot),
        margin_below=np.maximum(instants.joint_angles - robot.joint_lower, 0.0),
        margin_above=np.maximum(robot.joint_upper - instants.joint_angles, 0.0),
        max_torque=robot.max_torque,
        link_torques=link_torques(robot, instants.rpy, instants.joint_angles),
        safety_friction=np.full(len(load), force.safety_friction),
        pull=np.zeros(len(load)),
        min_safety_torque=force.safety_torque,
        unit=unit,
        length=robot.reach,
    )
