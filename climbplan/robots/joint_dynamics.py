"""Rotor inertia, damping and friction of joints, and their defaults.

An ideal gear of ratio n turns a motor's torque, speed and rotor inertia into n tau, omega / n and
n^2 J. The time J omega / tau, in which the largest torque takes the rotor to its largest speed, is
thus the same on both sides of the gear. It is a data sheet's mechanical time constant. Where
nothing is stated of a joint, the inertia of its rotor as the joint feels it is therefore

    J = T tau_max / omega_max,   T = 6 ms,

by the torque and speed limits. T is 6.3 ms of A1's motors (MuJoCo Menagerie: 0.01 kg m^2, 33.5 N m,
21 rad/s), 12.7 of Go1's (0.01, 23.7, 30.1), and 3.6, 3.7, 5.3 and 18.7 of the four of G1 (0.0251,
0.0102, 0.0036 and 0.00425 kg m^2 in BeyondMimic's whole-body tracking, at 139, 88, 25 and 5 N m,
20, 32, 37 and 22 rad/s): 7 ms in their geometric mean.

The derivative gain of position control damps that inertia critically on the joint's stiffness K:
D = 2 sqrt(K J).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array

TIME_CONSTANT = 0.006  # [s] mechanical, of motors of which nothing else is stated
MAX_SPEED = 60.0  # [rad/s], [m/s]: no joint reaches larger speed limits


@dataclass(frozen=True)
class JointDynamics:
    """Inertia, damping and friction of N limbs of J joints; of joints that slide in kg, N s/m, N.

    Attributes:
        rotor_inertia: (N, J) of motors behind their gears, as the joint feels it [kg m^2].
        damping: (N, J) derivative gain of position control [N m s/rad].
        viscous_friction: (N, J) of bearings and gears [N m s/rad].
        dry_friction: (N, J) of bearings and gears [N m].
    """

    rotor_inertia: Array
    damping: Array
    viscous_friction: Array
    dry_friction: Array


def default_rotor_inertia(max_torque: Array, max_speed: Array) -> Array:
    """Return the rotor inertia behind the gears by torque and speed limits [kg m^2].

    Args:
        max_torque: any shape [N m], of joints that slide [N].
        max_speed: of the same shape [rad/s], [m/s].
    """
    return np.asarray(TIME_CONSTANT * max_torque / np.minimum(max_speed, MAX_SPEED))


def default_damping(stiffness: Array, rotor_inertia: Array) -> Array:
    """Return the derivative gain that damps rotors critically [N m s/rad].

    Args:
        stiffness: of motors under position control, any shape [N m/rad].
        rotor_inertia: of the same shape [kg m^2].
    """
    return np.asarray(2 * np.sqrt(stiffness * rotor_inertia))
