"""Symbolic loads of an arm with mass: joint torques and the load of its anchor.

Angles, rates and accelerations of the joints are closed functions of the motion of the box
(`symbols.py`). Forces and moments follow by the recursive Newton-Euler algorithm from the anchor
outwards and back.
"""

from __future__ import annotations

import casadi as ca

from climbplan.limms.arms.symbols import build_arm_symbols
from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.modules.inertia import LinkBodies, build_link_bodies
from climbplan.limms.scene.limms_scene import GRAVITY, ModuleScene
from climbplan.limms.scene.phases import SupportModule


def build_load_function(scene: ModuleScene, limb: SupportModule) -> ca.Function:
    """Build the inverse dynamics of an arm.

    Returns:
        A function of box placement, velocity and acceleration (D each), reference angles (6), and
        force and moment (3 each) of the latch on the box. Its values are joint torques (6) [N m],
        and force [N] and moment [N m] (3 each) of the anchor on the arm. World frame.
    """
    state = build_arm_symbols(scene, limb)
    acceleration = ca.SX.sym("acceleration", state.place.numel())
    force, moment = ca.SX.sym("force", 3), ca.SX.sym("moment", 3)
    state_vector = ca.vertcat(state.place, state.velocity)
    rates_of_state = ca.vertcat(state.velocity, acceleration)
    joint_accelerations = ca.jtimes(state.rates, state_vector, rates_of_state)
    root = 1 - limb.box_end
    torque, anchor_force, anchor_moment = _newton_euler(
        scene,
        limb,
        root,
        angles=state.angles,
        rates=state.rates,
        joint_accelerations=joint_accelerations,
        force=force,
        moment=moment,
    )
    inputs = [state.place, state.velocity, acceleration, state.reference, force, moment]
    return ca.Function("loads", inputs, [torque, anchor_force, anchor_moment])


def _newton_euler(
    scene: ModuleScene,
    limb: SupportModule,
    root: int,
    *,
    angles: ca.SX,
    rates: ca.SX,
    joint_accelerations: ca.SX,
    force: ca.SX,
    moment: ca.SX,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return joint torques, anchor force and anchor moment by recursive Newton-Euler.

    The end `root` of the arm is fixed, and force and moment act on the box.
    """
    bodies = build_link_bodies(scene.module)
    lengths = scene.module.link_lengths
    frame, position = ca.SX(ca.DM(limb.other_rotation)), ca.SX(ca.DM(limb.fixed_position))
    angular_velocity, angular_acceleration = ca.SX.zeros(3), ca.SX.zeros(3)
    acceleration = ca.SX.zeros(3)
    sign = 1.0 if root == 0 else -1.0
    order = range(7) if root == 0 else range(6, -1, -1)
    # Force, moment about the centre of mass, and centre of mass of each link
    inertial_loads: dict[int, tuple[ca.SX, ca.SX, ca.SX]] = {}
    joints: dict[int, tuple[ca.SX, ca.SX]] = {}  # position and axis
    for k in order:
        if k != order[0]:
            joint = k - 1 if root == 0 else k
            axis = frame[:, 2 if ROLLS[joint] else 1]
            joints[joint] = (position, axis)
            angular_acceleration += (
                sign * axis * joint_accelerations[joint]
                + ca.cross(angular_velocity, axis) * sign * rates[joint]
            )
            angular_velocity += sign * axis * rates[joint]
            rotation = _joint_rotation(angles[joint], ROLLS[joint])
            frame = frame @ (rotation if root == 0 else rotation.T)
        axis_of_link = frame[:, 2]
        com_offset = (
            sign * axis_of_link * (bodies.com[k] if root == 0 else lengths[k] - bodies.com[k])
        )
        com_acceleration = (
            acceleration
            + _rigid_acceleration(angular_velocity, angular_acceleration, com_offset)
            + ca.DM([0, 0, GRAVITY])
        )
        inertial_loads[k] = (
            bodies.mass[k] * com_acceleration,
            _inertial_moment(bodies, k, axis_of_link, angular_velocity, angular_acceleration),
            position + com_offset,
        )
        step = sign * axis_of_link * lengths[k]
        acceleration += _rigid_acceleration(angular_velocity, angular_acceleration, step)
        position = position + step
    # From the box inwards: loads of the links beyond each joint, and of the box
    load, application = force, position
    total_force, total_moment = load, moment  # the arm exerts what the box receives
    torques: list[ca.SX] = [ca.SX(0)] * 6
    for k in reversed(order):
        link_force, link_moment, com = inertial_loads[k]
        joint_position = joints[k - 1 if root == 0 else k][0] if k != order[0] else None
        reference = (
            joint_position if joint_position is not None else ca.SX(ca.DM(limb.fixed_position))
        )
        total_moment = (
            total_moment
            + ca.cross(application - reference, total_force)
            + link_moment
            + ca.cross(com - reference, link_force)
        )
        total_force, application = total_force + link_force, reference
        if joint_position is not None:
            joint = k - 1 if root == 0 else k
            torques[joint] = sign * ca.dot(joints[joint][1], total_moment)
    return ca.vertcat(*torques), total_force, total_moment


def _joint_rotation(angle: ca.SX, is_roll: bool) -> ca.SX:
    """Return the rotation of one joint."""
    c, s = ca.cos(angle), ca.sin(angle)
    if is_roll:
        return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))


def _rigid_acceleration(
    angular_velocity: ca.SX, angular_acceleration: ca.SX, offset: ca.SX
) -> ca.SX:
    """Return the acceleration of a point of a rotating body relative to its origin."""
    return ca.cross(angular_acceleration, offset) + ca.cross(
        angular_velocity, ca.cross(angular_velocity, offset)
    )


def _inertial_moment(
    bodies: LinkBodies, k: int, axis: ca.SX, angular_velocity: ca.SX, angular_acceleration: ca.SX
) -> ca.SX:
    """Return the moment that changes the angular momentum of a link."""
    transverse, axial = bodies.transverse_inertia[k], bodies.axial_inertia[k]

    def inertia(vector: ca.SX) -> ca.SX:
        return transverse * vector + (axial - transverse) * ca.dot(vector, axis) * axis

    return inertia(angular_acceleration) + ca.cross(angular_velocity, inertia(angular_velocity))
