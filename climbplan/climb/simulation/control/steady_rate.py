"""Stability limits of the regulator's integration rate.

The body is a mass on the springs of its limbs, damped by the motors. The regulator commands an
offset u that integrates the body's deviation x at a rate r:

    M x'' + C x' + A x = A_0 u,   u' = -r x,

By the Routh-Hurwitz criterion each mode v of A v = w^2 M v is stable while
r < (v'Cv / v'Mv) (v'Av / v'A_0v). A heavy robot on soft joints, or one whose forces reduce its
stiffness A, has to be corrected slowly.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.control.joint_regulator import RATE
from climbplan.mechanics.stability import braced_body, relative_stiffness
from climbplan.robots.kinematics import by_point, point_jacobian, pushed_points
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import NOMINAL
from climbplan.simulation.motors import compute_joint_damping

_RATE_FRACTION = 0.6  # of the rate at which the slowest mode becomes unstable
_MIN_STIFFNESS_RATIO = 1e-3  # remaining stiffness by that without forces, below which the rate is 0


def compute_stable_rates(plan: ClimbPlan) -> Array:
    """Compute stable rates (T,) of the plan's samples [1/s]: at most `RATE`, as with grippers."""
    count = len(plan.trajectory.time)
    if plan.grips is not None or plan.robot.sole is not None:
        return np.full(count, RATE)
    rates = _compute_rates(plan)
    before = np.maximum(sample_instants(plan), 0)
    after = np.minimum(before + 1, len(rates) - 1)
    return np.minimum(rates[before], rates[after])


def _compute_rates(plan: ClimbPlan) -> Array:
    """Compute stable rates (K,) at the plan's instants [1/s]."""
    robot, instants = plan.robot, plan.instants
    pose = instants.rpy, instants.joint_angles
    jacobian = point_jacobian(robot, *pose, instants.normal)
    arms = pushed_points(robot, instants.toes, instants.normal) - instants.com[:, None]
    contact = by_point(robot, instants.contact, 1)
    normal = by_point(robot, instants.normal, 1)
    body = braced_body(robot, *pose, jacobian, arms, contact=contact, normal=normal)
    change = relative_stiffness(body, plan.forces.force)
    damping = compute_joint_damping(robot, NOMINAL)
    turn = body.turn.reshape(len(arms), -1, 6)
    damped = np.swapaxes(turn, 1, 2) @ (body.turn * damping[..., None]).reshape(turn.shape)
    mass = _compute_mass_matrices(robot, *pose)
    rates = np.empty(len(arms))
    for k, transform in enumerate(body.whitening):
        stiffness = np.eye(6) + change[k]
        if np.linalg.eigvalsh(stiffness)[0] < _MIN_STIFFNESS_RATIO:
            rates[k] = 0.0
            continue
        inverse_squared_frequency, modes = eigh(
            transform.T @ mass[k] @ transform, stiffness
        )  # 1 / w^2
        damping_of_modes = np.einsum(
            "im,ij,jm->m", modes, transform.T @ damped[k] @ transform, modes
        )
        inertia = inverse_squared_frequency * (modes**2).sum(axis=0)
        is_moving = inertia > 0
        rates[k] = (damping_of_modes[is_moving] / inertia[is_moving]).min(initial=np.inf)
    return np.minimum(_RATE_FRACTION * rates, RATE)


def _compute_mass_matrices(robot: Robot, rpy: Array, angles: Array) -> Array:
    """Compute mass matrices (K, 6, 6) of the robot about the body's origin [kg, kg m^2]."""
    links, chain = robot.links, robot.mechanism
    mass = np.zeros((len(rpy), 6, 6))
    mass[:, range(3), range(3)] = robot.mass
    if links is None or not isinstance(chain, SerialChain):
        half_size = np.ptp(robot.body_hull, axis=0) / 2
        inertia = np.diag(robot.mass / 3 * ((half_size**2).sum() - half_size**2))[None]
    else:
        centers = links.middles(chain, angles)  # (K, N, J, 3)
        outer_product = centers[..., :, None] * centers[..., None, :]
        parallel_axis = (centers**2).sum(axis=-1)[..., None, None] * np.eye(3) - outer_product
        inertia = links.body_inertia + np.einsum("nj,knjab->kab", links.mass, parallel_axis)
    rotation = rotation_world_body(rpy)
    mass[:, 3:, 3:] = rotation @ inertia @ np.swapaxes(rotation, -1, -2)
    return mass
