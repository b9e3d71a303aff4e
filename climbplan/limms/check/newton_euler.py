"""Newton-Euler along a module: what force and moment its links ask for.

R. Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5.3, in world coordinates: speeds and
accelerations from the held end outwards, then force and moment of each link about its COM.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.inertia import LinkBodies
from climbplan.limms.scene.limms_scene import GRAVITY, Points

# Joint k lies at point k + 1; its axis is this column of the frames on both sides of it
JOINT_COLUMN = (2, 1, 1, 2, 1, 2)


class EndMotion(NamedTuple):
    """How an end of a module moves: all (M, 3), world frame."""

    spin: Array  # angular velocity [rad/s]
    spin_rate: Array  # angular acceleration [rad/s^2]
    acceleration: Array  # of the point [m/s^2]


class Demand(NamedTuple):
    """What the links of a module ask for (M samples), world frame."""

    force: Array  # (M, 7, 3) mass times acceleration less gravity [N]
    moment: Array  # (M, 7, 3) about each link's COM [N m]
    com: Array  # (M, 7, 3) [m]
    ends: tuple[EndMotion, EndMotion]  # of first and last end


def at_rest(count: int) -> EndMotion:
    """The motion of an end that is held by what does not move."""
    return EndMotion(*(np.zeros((count, 3)) for _ in range(3)))


def demand(
    bodies: LinkBodies, points: Points, root: int, held: EndMotion, rates: Array, turns: Array
) -> Demand:
    """Demand of a module whose end `root` (0 first, 1 last) moves as `held`.

    rates, turns: (M, 6) joint speeds [rad/s] and accelerations [rad/s^2].
    """
    count = len(rates)
    force, moment, com = (np.empty((count, 7, 3)) for _ in range(3))
    spin, spin_rate, acceleration = held
    order = range(7) if root == 0 else range(6, -1, -1)
    for k in order:
        frame = points.rotation[:, k]
        if k != order[0]:
            joint = k - 1 if root == 0 else k
            sign = 1.0 if root == 0 else -1.0
            axis = frame[:, :, JOINT_COLUMN[joint]]
            rate, turn = sign * rates[:, joint, None], sign * turns[:, joint, None]
            spin_rate = spin_rate + axis * turn + np.cross(spin, axis) * rate
            spin = spin + axis * rate
        near, far = (k, k + 1) if root == 0 else (k + 1, k)
        along = frame[:, :, 2]
        com[:, k] = points.position[:, k] + bodies.com[k] * along
        out = com[:, k] - points.position[:, near]
        middle = acceleration + _carried(spin, spin_rate, out)
        force[:, k] = bodies.mass[k] * (middle + np.array([0.0, 0.0, GRAVITY]))
        moment[:, k] = _turned(bodies.across[k], bodies.along[k], along, spin, spin_rate)
        step = points.position[:, far] - points.position[:, near]
        acceleration = acceleration + _carried(spin, spin_rate, step)
    free = EndMotion(spin, spin_rate, acceleration)
    return Demand(force, moment, com, (held, free) if root == 0 else (free, held))


def total(needed: Demand, about: Array) -> tuple[Array, Array]:
    """Force and moment (M, 3) that a whole module asks for, the moment about points (M, 3)."""
    arms = needed.com - about[:, None]
    moment = (needed.moment + np.cross(arms, needed.force)).sum(axis=1)
    return needed.force.sum(axis=1), moment


def joint_torques(needed: Demand, points: Points, force: Array, moment: Array) -> Array:
    """Torques (M, 6) [N m] of all joints, force and moment (M, 3) acting at the last end."""
    torque = np.empty((len(force), 6))
    for j in range(6):
        at = points.position[:, j + 1]
        arms = needed.com[:, j + 1 :] - at[:, None]
        beyond = needed.moment[:, j + 1 :] + np.cross(arms, needed.force[:, j + 1 :])
        given = moment + np.cross(points.position[:, 7] - at, force)
        axis = points.rotation[:, j, :, JOINT_COLUMN[j]]
        torque[:, j] = ((beyond.sum(axis=1) - given) * axis).sum(axis=1)
    return torque


def _carried(spin: Array, spin_rate: Array, out: Array) -> Array:
    carried: Array = np.cross(spin_rate, out) + np.cross(spin, np.cross(spin, out))
    return carried


def _turned(across: float, along: float, axis: Array, spin: Array, rate: Array) -> Array:
    """Rate of angular momentum (M, 3) of a body that is round about `axis`: I a + w x I w."""

    def inertia(vector: Array) -> Array:
        part = (vector * axis).sum(axis=1, keepdims=True)
        applied: Array = across * vector + (along - across) * part * axis
        return applied

    turned: Array = inertia(rate) + np.cross(spin, inertia(spin))
    return turned
