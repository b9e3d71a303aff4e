"""The stance where no plan is to be had: stay upright before all else, carry the weight and brake.

Equal forces of all legs would brake too, and turn the body over within 0.2 s: their moment is that
of half the weight 20 cm below. Forces are therefore the answer of a small QP, within friction
pyramids and limits, that tracks the net moment by far the most, then vertical force and brake.
"""

from __future__ import annotations

import daqp
import numpy as np
from scipy.linalg import block_diag

from climbplan.arrays import Array, BoolArray
from climbplan.robots.leg_order import alternating
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.walking.check.truth import toes_in_body
from climbplan.walking.online.footholds import grounded
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    SPIN,
    VELOCITY,
    Gait,
    WalkTask,
    WalkTrajectory,
)

_SLACK = 0.02  # [m] out of its box that a toe may be told to stand
_FRICTION = 0.8  # share of the friction coefficient that is made use of
_FACETS = 8
_BRAKE = 0.1  # [s] in which the body is to come to rest
_ANGLES, _SPIN = 60.0, 12.0  # [1/s^2], [1/s] pull upright, and damping
_LIFT = 8.0  # [1/s] damping of vertical motion
# Of moments over a length, vertical force, brake: pressing harder to brake harder is welcome
_IMPORTANCE = (100.0, 1.0, 1.0)
_LENGTH = 0.2  # [m] that makes moments comparable
_RIDGE = 1e-6  # even shares where nothing else decides
_SOLVED = 1


def safe_stance(task: WalkTask) -> WalkTrajectory:
    """Legs down that reach the ground, against motion and tilt; the body is taken to stay."""
    start = task.start
    stands = _standing(task)
    state = np.tile(start.state, (task.knots + 1, 1))
    toes = np.tile(start.toes, (task.knots + 1, 1, 1))
    # Others are set down ahead of where the body moves.
    R = rotation_world_body(start.state[ANGLES])
    ahead = start.state[POSITION] + 1.5 * task.step * start.state[VELOCITY]
    under = grounded(task.ground, ahead + task.body.toe_center @ R.T)
    toes[1:, ~stands] = under[~stands]
    force = np.zeros_like(toes)
    force[:-1] = braced_forces(task, start.state, start.toes, stands)
    contact = np.ones(toes.shape[:2], bool)
    contact[0] = stands
    force[1:-1, ~stands] = 0.0
    region = np.tile(task.ground.nearest(toes[1, :, :2]), (len(contact), 1))
    return WalkTrajectory(state, toes, force, Gait(contact, region))


def _standing(task: WalkTask) -> BoolArray:
    """(L,) legs whose toes stay in reach while the body moves on, or those of the better half.

    Halves alternate: diagonals, tripods. The others step.
    """
    moved = task.start.state.copy()
    legs = task.body.leg_count
    beyond = np.zeros(legs)
    for share in (0.0, 1.0):
        moved[POSITION] = task.start.state[POSITION] + share * task.steps[0] * moved[VELOCITY]
        off = np.abs(toes_in_body(moved, task.start.toes) - task.body.toe_center)
        beyond = np.maximum(beyond, (off - task.body.toe_half).max(axis=1))
    reached: BoolArray = beyond <= _SLACK
    if 2 * reached.sum() < legs:
        halves = [alternating(legs) == half for half in (0, 1)]
        reached[min(halves, key=lambda half: beyond[half].max())] = True
    return reached


def braced_forces(task: WalkTask, state: Array, toes: Array, stands: BoolArray) -> Array:
    """(L, 3) contact forces of the legs that stand, world frame; one leg gives next to none."""
    body = task.body
    force = np.zeros_like(toes)
    legs = np.flatnonzero(stands)
    if not len(legs):
        return force
    # The body moves on while they act: arms are those half-way through the knot.
    arms = toes[legs] - state[POSITION] - 0.5 * task.steps[0] * state[VELOCITY]
    weight = body.mass * body.gravity
    R = rotation_world_body(state[ANGLES])
    inertia = R @ body.inertia @ R.T
    spin, angles = state[SPIN], np.array([*state[6:8], 0.0])
    moment = inertia @ (-_ANGLES * angles - _SPIN * spin)
    upward = max(0.0, weight - body.mass * _LIFT * state[5])
    brake = -body.mass * state[3:5] / _BRAKE
    room = _FRICTION * task.ground.friction * weight
    brake = brake * min(1.0, room / max(float(np.hypot(*brake)), 1e-9))
    wanted = np.array([*brake, upward, *moment / _LENGTH]) / weight
    # Unknowns: forces in units of the weight
    net = np.hstack([np.vstack([np.eye(3), skew(arm) / _LENGTH]) for arm in arms])
    moments, vertical, sideways = _IMPORTANCE
    scale = np.array([sideways, sideways, vertical, moments, moments, moments])
    hessian = net.T @ (scale[:, None] * net) + _RIDGE * np.eye(3 * len(legs))
    even = np.tile([0.0, 0.0, 1.0 / len(legs)], len(legs))
    gradient = -net.T @ (scale * wanted) - _RIDGE * even
    angle = 2 * np.pi * (np.arange(_FACETS) + 0.5) / _FACETS
    slope = _FRICTION * task.ground.friction * np.cos(np.pi / _FACETS)
    facets = np.column_stack([np.cos(angle), np.sin(angle), np.full(_FACETS, -slope)])
    frames = task.ground.frame[task.ground.nearest(toes[legs, :2])]
    rows = block_diag(*(facets @ frame for frame in frames))
    most = body.force_limit / weight
    upper = np.concatenate([np.full(3 * len(legs), most), np.zeros(len(rows))])
    lower = np.concatenate([np.tile([-most, -most, 0.0], len(legs)), np.full(len(rows), -1e30)])
    z, _, flag, _ = daqp.solve(hessian, gradient, rows, upper, lower)
    share = np.asarray(z) if flag == _SOLVED else even
    force[legs] = weight * share.reshape(-1, 3)
    return force
