"""How fast a departure of the body may be worked off before its springs and the regulator swing up.

On its limbs the body is a mass on springs, damped by what motors damp. Told to move by an offset u
that integrates its departure x at a rate r,

    M x'' + C x' + A x = A_0 u,   u' = -r x,

each mode v of A v = w^2 M v stays at rest while r < (v'Cv / v'Mv) (v'Av / v'A_0v), by Routh and
Hurwitz: a heavy robot on soft joints, or one whose forces leave little of its stiffness, has to be
corrected slowly.
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
from climbplan.simulation.motors import joint_damping

_PART = 0.6  # of the rate at which the slowest mode would swing up
_STABLE = 1e-3  # share of the stiffness left, below which no mode is at rest


def steady_rates(plan: ClimbPlan) -> Array:
    """(T,) rates of the plan's samples [1/s], at most `RATE`; that where grippers hold."""
    count = len(plan.trajectory.time)
    if plan.grips is not None or plan.robot.sole is not None:
        return np.full(count, RATE)
    rates = _at_instants(plan)
    before = np.maximum(sample_instants(plan), 0)
    after = np.minimum(before + 1, len(rates) - 1)
    return np.minimum(rates[before], rates[after])


def _at_instants(plan: ClimbPlan) -> Array:
    """(K,) rates at the plan's instants."""
    robot, instants = plan.robot, plan.instants
    pose = instants.rpy, instants.joint_angles
    jacobian = point_jacobian(robot, *pose, instants.normal)
    arms = pushed_points(robot, instants.toes, instants.normal) - instants.com[:, None]
    contact = by_point(robot, instants.contact, 1)
    normal = by_point(robot, instants.normal, 1)
    body = braced_body(robot, *pose, jacobian, arms, contact, normal)
    change = relative_stiffness(body, plan.forces.force)
    damping = joint_damping(robot, NOMINAL)
    turn = body.turn.reshape(len(arms), -1, 6)
    damped = np.swapaxes(turn, 1, 2) @ (body.turn * damping[..., None]).reshape(turn.shape)
    mass = _mass_matrices(robot, *pose)
    rates = np.empty(len(arms))
    for k, white in enumerate(body.whitening):
        stiff = np.eye(6) + change[k]
        if np.linalg.eigvalsh(stiff)[0] < _STABLE:
            rates[k] = 0.0
            continue
        slow, modes = eigh(white.T @ mass[k] @ white, stiff)  # 1 / w^2
        drag = np.einsum("im,ij,jm->m", modes, white.T @ damped[k] @ white, modes)
        moved = slow * (modes**2).sum(axis=0)
        here = moved > 0
        rates[k] = (drag[here] / moved[here]).min(initial=np.inf)
    return np.minimum(_PART * rates, RATE)


def _mass_matrices(robot: Robot, rpy: Array, angles: Array) -> Array:
    """(K, 6, 6) of the whole robot about the body's origin, world axes [kg, kg m^2]."""
    links, chain = robot.links, robot.mechanism
    out = np.zeros((len(rpy), 6, 6))
    out[:, range(3), range(3)] = robot.mass
    if links is None or not isinstance(chain, SerialChain):
        size = np.ptp(robot.body_hull, axis=0) / 2
        own = np.diag(robot.mass / 3 * ((size**2).sum() - size**2))[None]
    else:
        at = links.middles(chain, angles)  # (K, N, J, 3)
        along = at[..., :, None] * at[..., None, :]
        across = (at**2).sum(axis=-1)[..., None, None] * np.eye(3) - along
        own = links.body_inertia + np.einsum("nj,knjab->kab", links.mass, across)
    rotation = rotation_world_body(rpy)
    out[:, 3:, 3:] = rotation @ own @ np.swapaxes(rotation, -1, -2)
    return out
