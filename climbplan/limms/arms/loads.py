"""Symbolic loads of an arm with mass: joint torques and the load of its anchor.

Angles, rates and accelerations of the joints are closed functions of the motion of the box
(`symbols.py`). Forces and moments follow by the recursive Newton-Euler algorithm from the anchor
outwards and back.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    inertial = _compute_inertial_loads(scene, limb, state.angles, state.rates, joint_accelerations)
    torque, anchor_force, anchor_moment = _propagate_loads(limb, inertial, force, moment)
    inputs = [state.place, state.velocity, acceleration, state.reference, force, moment]
    return ca.Function("loads", inputs, [torque, anchor_force, anchor_moment])


@dataclass(frozen=True)
class _InertialLoads:
    """What the motion of the links does to them, in the order from the anchor to the box."""

    links: dict[int, tuple[ca.SX, ca.SX, ca.SX]]  # force, moment about the centre of mass, centre
    joints: dict[int, tuple[ca.SX, ca.SX]]  # position and axis
    box_end: ca.SX  # position of the end at the box


def _compute_inertial_loads(
    scene: ModuleScene, limb: SupportModule, angles: ca.SX, rates: ca.SX, joint_accelerations: ca.SX
) -> _InertialLoads:
    """Propagate motion from the fixed end of the arm to the box, and return loads of the links."""
    bodies = build_link_bodies(scene.module)
    lengths = scene.module.link_lengths
    frame, position = ca.SX(ca.DM(limb.other_rotation)), ca.SX(ca.DM(limb.fixed_position))
    angular_velocity, angular_acceleration = ca.SX.zeros(3), ca.SX.zeros(3)
    acceleration = ca.SX.zeros(3)
    root, sign, order = _order_links(limb)
    links: dict[int, tuple[ca.SX, ca.SX, ca.SX]] = {}
    joints: dict[int, tuple[ca.SX, ca.SX]] = {}
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
        links[k] = (
            bodies.mass[k] * com_acceleration,
            _inertial_moment(bodies, k, axis_of_link, angular_velocity, angular_acceleration),
            position + com_offset,
        )
        step = sign * axis_of_link * lengths[k]
        acceleration += _rigid_acceleration(angular_velocity, angular_acceleration, step)
        position = position + step
    return _InertialLoads(links, joints, position)


def _propagate_loads(
    limb: SupportModule, inertial: _InertialLoads, force: ca.SX, moment: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return joint torques, anchor force and anchor moment, from the box to the fixed end.

    Force and moment act on the box, and the arm exerts what the box receives.
    """
    root, sign, order = _order_links(limb)
    total_force, total_moment, application = force, moment, inertial.box_end
    torques: list[ca.SX] = [ca.SX(0)] * 6
    for k in reversed(order):
        link_force, link_moment, com = inertial.links[k]
        joint = k - 1 if root == 0 else k
        has_joint = k != order[0]
        reference = inertial.joints[joint][0] if has_joint else ca.SX(ca.DM(limb.fixed_position))
        total_moment = (
            total_moment
            + ca.cross(application - reference, total_force)
            + link_moment
            + ca.cross(com - reference, link_force)
        )
        total_force, application = total_force + link_force, reference
        if has_joint:
            torques[joint] = sign * ca.dot(inertial.joints[joint][1], total_moment)
    return ca.vertcat(*torques), total_force, total_moment


def _order_links(limb: SupportModule) -> tuple[int, float, range]:
    """Return the fixed end of an arm, its sign along the chain, and its links from there."""
    root = 1 - limb.box_end
    return (root, 1.0, range(7)) if root == 0 else (root, -1.0, range(6, -1, -1))


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
