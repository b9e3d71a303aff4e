"""What an arm with mass asks of its joints and of the latch it hangs on, in symbols.

Angles, rates and accelerations of the joints are closed functions of how the box is placed, moves
and speeds up (`symbols.py`); forces and moments follow by Newton-Euler from the latch outwards.
"""

from __future__ import annotations

import casadi as ca

from climbplan.limms.arms.symbols import arm_symbols
from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.modules.inertia import LinkBodies, link_bodies
from climbplan.limms.scene.limms_scene import GRAVITY, Scene
from climbplan.limms.scene.phases import Limb


def load_function(scene: Scene, limb: Limb) -> ca.Function:
    """Of box placement, velocity, acceleration (D each), reference angles (6), force and moment (3
    each) of the latch on the box: joint torques (6) [N m], force [N] and moment [N m] (3 each) of
    the latch on the arm's other end. World frame.
    """
    state = arm_symbols(scene, limb)
    acceleration = ca.SX.sym("acceleration", state.place.numel())
    force, moment = ca.SX.sym("force", 3), ca.SX.sym("moment", 3)
    moving = ca.vertcat(state.place, state.velocity)
    ahead = ca.vertcat(state.velocity, acceleration)
    turns = ca.jtimes(state.rates, moving, ahead)
    root = 1 - limb.box_end
    torque, held_force, held_moment = _newton_euler(
        scene, limb, root, state.angles, state.rates, turns, force, moment
    )
    given = [state.place, state.velocity, acceleration, state.reference, force, moment]
    return ca.Function("loads", given, [torque, held_force, held_moment])


def _newton_euler(
    scene: Scene,
    limb: Limb,
    root: int,
    angles: ca.SX,
    rates: ca.SX,
    turns: ca.SX,
    force: ca.SX,
    moment: ca.SX,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """As `load_function`; the arm's end `root` is fixed, the latch's force acts on the box."""
    bodies = link_bodies(scene.module)
    lengths = scene.module.link_lengths
    frame, place = ca.SX(ca.DM(limb.other_rotation)), ca.SX(ca.DM(limb.fixed_position))
    spin, spin_rate, moved = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3)
    sign = 1.0 if root == 0 else -1.0
    order = range(7) if root == 0 else range(6, -1, -1)
    wanted: dict[int, tuple[ca.SX, ca.SX, ca.SX]] = {}  # force, moment about the COM, COM
    joints: dict[int, tuple[ca.SX, ca.SX]] = {}  # place and axis
    for k in order:
        if k != order[0]:
            joint = k - 1 if root == 0 else k
            axis = frame[:, 2 if ROLLS[joint] else 1]
            joints[joint] = (place, axis)
            spin_rate += sign * axis * turns[joint] + ca.cross(spin, axis) * sign * rates[joint]
            spin += sign * axis * rates[joint]
            turn = _turn(angles[joint], ROLLS[joint])
            frame = frame @ (turn if root == 0 else turn.T)
        along = frame[:, 2]
        out = sign * along * (bodies.com[k] if root == 0 else lengths[k] - bodies.com[k])
        middle = moved + _carried(spin, spin_rate, out) + ca.DM([0, 0, GRAVITY])
        wanted[k] = (
            bodies.mass[k] * middle,
            _moment(bodies, k, along, spin, spin_rate),
            place + out,
        )
        step = sign * along * lengths[k]
        moved += _carried(spin, spin_rate, step)
        place = place + step
    # From the box inwards: what is beyond each joint, and the box's reaction
    reaction, about = force, place
    total_force, total_moment = reaction, moment  # the box takes them: the arm has to give them
    torques: list[ca.SX] = [ca.SX(0)] * 6
    for k in reversed(order):
        own_force, own_moment, com = wanted[k]
        near = joints[k - 1 if root == 0 else k][0] if k != order[0] else None
        here = near if near is not None else ca.SX(ca.DM(limb.fixed_position))
        total_moment = (
            total_moment
            + ca.cross(about - here, total_force)
            + own_moment
            + ca.cross(com - here, own_force)
        )
        total_force, about = total_force + own_force, here
        if near is not None:
            joint = k - 1 if root == 0 else k
            torques[joint] = sign * ca.dot(joints[joint][1], total_moment)
    return ca.vertcat(*torques), total_force, total_moment


def _turn(angle: ca.SX, is_roll: bool) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    if is_roll:
        return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))


def _carried(spin: ca.SX, spin_rate: ca.SX, out: ca.SX) -> ca.SX:
    return ca.cross(spin_rate, out) + ca.cross(spin, ca.cross(spin, out))


def _moment(bodies: LinkBodies, k: int, axis: ca.SX, spin: ca.SX, rate: ca.SX) -> ca.SX:
    across, along = bodies.across[k], bodies.along[k]

    def inertia(vector: ca.SX) -> ca.SX:
        return across * vector + (along - across) * ca.dot(vector, axis) * axis

    return inertia(rate) + ca.cross(spin, inertia(spin))
