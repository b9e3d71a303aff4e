"""The fallback balance controller: a safe stance where no plan is available.

It keeps the body upright before all else, carries the weight and brakes. Equal forces of all legs
would brake, too, but their moment would turn the body over within 0.2 s. Forces are therefore the
solution of a small weighted least-squares QP within friction pyramids and force limits. It tracks
the net moment with by far the largest weight, then vertical force and braking force.
"""

from __future__ import annotations

import daqp
import numpy as np
from scipy.linalg import block_diag

from climbplan.arrays import Array, BoolArray
from climbplan.robots.leg_order import alternating
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.walking.check.reference_dynamics import transform_toes_to_body
from climbplan.walking.online.footholds import project_to_footholds
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    SPIN,
    VELOCITY,
    Gait,
    WalkTask,
    WalkTrajectory,
)

_REACH_TOLERANCE = 0.02  # [m] outside its box at which a toe may stand
_FRICTION_FRACTION = 0.8  # of the friction coefficient that is used
_FACETS = 8
_BRAKING_TIME = 0.1  # [s] until the body is at rest
_TILT_GAIN, _RATE_GAIN = 60.0, 12.0  # [1/s^2], [1/s] PD gains of the attitude
_VERTICAL_DAMPING = 8.0  # [1/s]
# Of moments, vertical force, and braking force: more vertical force for more braking is welcome
_TASK_WEIGHTS = (100.0, 1.0, 1.0)
_MOMENT_LENGTH = 0.2  # [m] by which moments are divided to compare them with forces
_REGULARISATION = 1e-6  # towards equal forces
_OPTIMAL = 1


def plan_safe_stance(task: WalkTask) -> WalkTrajectory:
    """Return a plan in which legs stand and balance, and the body stays where it is.

    Legs that reach the ground stand at once, or the better half of the legs if too few do; from the
    second knot on all legs stand.
    """
    start = task.start
    in_stance = _select_stance_legs(task)
    state = np.tile(start.state, (task.knots + 1, 1))
    toes = np.tile(start.toes, (task.knots + 1, 1, 1))
    # The other legs land ahead of the moving body.
    R = rotation_world_body(start.state[ANGLES])
    predicted_position = start.state[POSITION] + 1.5 * task.dt * start.state[VELOCITY]
    touchdown = project_to_footholds(task.ground, predicted_position + task.body.toe_center @ R.T)
    toes[1:, ~in_stance] = touchdown[~in_stance]
    force = np.zeros_like(toes)
    force[:-1] = solve_balance_forces(task, start.state, start.toes, in_stance)
    contact = np.ones(toes.shape[:2], bool)
    contact[0] = in_stance
    force[1:-1, ~in_stance] = 0.0
    region = np.tile(task.ground.nearest(toes[1, :, :2]), (len(contact), 1))
    return WalkTrajectory(state, toes, force, Gait(contact, region))


def _select_stance_legs(task: WalkTask) -> BoolArray:
    """Return the legs (L,) whose toes stay in reach, or those of the better half.

    Halves alternate between legs: diagonals, tripods. The other half steps.
    """
    predicted = task.start.state.copy()
    legs = task.body.leg_count
    violation = np.zeros(legs)
    for fraction in (0.0, 1.0):
        predicted[POSITION] = (
            task.start.state[POSITION] + fraction * task.steps[0] * predicted[VELOCITY]
        )
        offset = np.abs(transform_toes_to_body(predicted, task.start.toes) - task.body.toe_center)
        violation = np.maximum(violation, (offset - task.body.toe_half).max(axis=1))
    reached: BoolArray = violation <= _REACH_TOLERANCE
    if 2 * reached.sum() < legs:
        halves = [alternating(legs) == half for half in (0, 1)]
        reached[min(halves, key=lambda half: violation[half].max())] = True
    return reached


def solve_balance_forces(task: WalkTask, state: Array, toes: Array, in_stance: BoolArray) -> Array:
    """Return contact forces (L, 3) of the standing legs, world frame [N].

    A single leg exerts next to no force, because its moment would tip the body.
    """
    body = task.body
    force = np.zeros_like(toes)
    legs = np.flatnonzero(in_stance)
    if not len(legs):
        return force
    # The body moves while the forces act: moment arms are those half-way through the interval.
    arms = toes[legs] - state[POSITION] - 0.5 * task.steps[0] * state[VELOCITY]
    weight = body.mass * body.gravity
    R = rotation_world_body(state[ANGLES])
    inertia = R @ body.inertia @ R.T
    angular_velocity, tilt = state[SPIN], np.array([*state[6:8], 0.0])
    moment = inertia @ (-_TILT_GAIN * tilt - _RATE_GAIN * angular_velocity)
    vertical_force = max(0.0, weight - body.mass * _VERTICAL_DAMPING * state[5])
    brake = -body.mass * state[3:5] / _BRAKING_TIME
    friction_limit = _FRICTION_FRACTION * task.ground.friction * weight
    brake = brake * min(1.0, friction_limit / max(float(np.hypot(*brake)), 1e-9))
    desired_wrench = np.array([*brake, vertical_force, *moment / _MOMENT_LENGTH]) / weight
    # The unknowns are forces in units of the weight.
    wrench_map = np.hstack([np.vstack([np.eye(3), skew(arm) / _MOMENT_LENGTH]) for arm in arms])
    moments, vertical, sideways = _TASK_WEIGHTS
    scale = np.array([sideways, sideways, vertical, moments, moments, moments])
    hessian = wrench_map.T @ (scale[:, None] * wrench_map) + _REGULARISATION * np.eye(3 * len(legs))
    equal_split = np.tile([0.0, 0.0, 1.0 / len(legs)], len(legs))
    gradient = -wrench_map.T @ (scale * desired_wrench) - _REGULARISATION * equal_split
    angle = 2 * np.pi * (np.arange(_FACETS) + 0.5) / _FACETS
    slope = _FRICTION_FRACTION * task.ground.friction * np.cos(np.pi / _FACETS)
    facets = np.column_stack([np.cos(angle), np.sin(angle), np.full(_FACETS, -slope)])
    frames = task.ground.frame[task.ground.nearest(toes[legs, :2])]
    rows = block_diag(*(facets @ frame for frame in frames))
    unit_force_limit = body.force_limit / weight
    upper = np.concatenate([np.full(3 * len(legs), unit_force_limit), np.zeros(len(rows))])
    lower = np.concatenate(
        [np.tile([-unit_force_limit, -unit_force_limit, 0.0], len(legs)), np.full(len(rows), -1e30)]
    )
    z, _, flag, _ = daqp.solve(hessian, gradient, rows, upper, lower)
    solution = np.asarray(z) if flag == _OPTIMAL else equal_split
    force[legs] = weight * solution.reshape(-1, 3)
    return force
