"""Where the body stands before a limb is lifted: over the limbs that stay.

Between walls limbs brace, and a body that goes straight from posture to posture is held wherever it
is. On level ground it is held by its weight alone, which has to act between the toes that stand.
So before each lift the body leaves its straight way by the least level shift d for which contact
forces f of the standing limbs balance the load (F, M) with the margins of the spec:

    minimise    |d|^2                                  |d| <= posture.steps.shift_max
    such that   sum f = -F,   sum (p - c) x f + d x F = -M
                |f_t| <= mu / S_mu (n . f - friction margin),   n . f >= pressure margin
                |J^T f| <= torque limits / S_tau

which is a second-order cone program, as the load, and so the sum of all f, is known. Jacobians are
those of the body on its way. On slopes, stairs and walls it is the same problem. Commands and
stability are left to the force planner, joint bounds to the exact kinematics. Where no shift keeps
the whole margins, half of them are asked for, then none; where none holds the robot either, the
body keeps to its way, and the force planner says what conflicts.
"""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene import MotionScene
from climbplan.mechanics.equilibrium import grasp_matrix, total_load
from climbplan.mechanics.friction import contact_frame
from climbplan.robots.kinematics import contact_jacobian, contact_points, inverse, to_body
from climbplan.robots.rotations import Array

_SHARES = (1.0, 0.5, 0.0)  # of the margins, asked for in turn
_EVEN = 1e-6  # [m^2] weight of the squared forces, in units of the load
_NONE = 1e-5  # [m] a shift that counts as none
_IN_HAND = 0.02  # of the torque limits, as Jacobians change with the shift
_SOLVED = ("Solved", "AlmostSolved")
_POSES = 6  # looked at along the body's way from one lift to the next


def balancing_shifts(
    scene: MotionScene, lifts: Instants, most: float | None = None, narrower: float = 1.0
) -> Array:
    """(L, 3) level shifts of the body [m] at instants with lifted limbs; zeros where none helps.

    lifts: L instants with the body on its straight way; their joint angles are not looked at.
    most: the largest shift if not the spec's; narrower: factor on friction.
    """
    most = scene.spec.posture.steps.shift_max if most is None else most
    robot = scene.robot
    angles = inverse(robot, to_body(lifts.com, lifts.rpy, lifts.toes)).best()
    out_of_reach = np.isnan(angles).any(axis=-1)  # which a shift may mend: torques are left open
    jacobian = contact_jacobian(robot, lifts.rpy, np.nan_to_num(angles), lifts.normal)
    jacobian[out_of_reach] = 0.0
    return np.array(
        [_least_shift(scene, lifts, k, jacobian[k], most, narrower) for k in range(lifts.count)]
    )


def _least_shift(
    scene: MotionScene, lifts: Instants, k: int, jacobian: Array, most: float, narrower: float
) -> Array:
    """(3,) for one instant; jacobian: (N, 3, J), world."""
    spec, robot = scene.spec, scene.robot
    stands = np.flatnonzero(lifts.contact[k])
    load = total_load(robot, lifts.external_wrench[k])
    unit = max(float(np.linalg.norm(load[:3])), 1e-9)
    n = len(stands)
    size = 2 + 3 * n
    # Equilibrium, forces in units of the load
    force, moment = load[:3] / unit, load[3:] / unit
    equal = np.zeros((6, size))
    touching = contact_points(robot, lifts.toes[k, stands], lifts.normal[k, stands])
    equal[:, 2:] = grasp_matrix(touching - lifts.com[k])
    equal[3:, 0] = np.cross([1.0, 0.0, 0.0], force)
    equal[3:, 1] = np.cross([0.0, 1.0, 0.0], force)
    frame = contact_frame(lifts.normal[k, stands]).axes  # (n, 3, 3)
    steep = narrower * lifts.mu[k, stands] / spec.force.safety_friction
    taken = jacobian[stands] * unit * spec.force.safety_torque / robot.max_torque[stands, None]
    turns = np.zeros((n, 2, robot.joint_count, size))
    press = np.zeros((n, size))
    cones = np.zeros((n, 3, size))
    for i in range(n):
        own = slice(2 + 3 * i, 5 + 3 * i)
        turns[i, 0][:, own], turns[i, 1][:, own] = taken[i].T, -taken[i].T
        press[i, own] = -frame[i, 0]
        cones[i, :, own] = -frame[i]
        cones[i, 0, own] *= steep[i]
    ball = np.zeros((3, size))
    ball[1, 0] = ball[2, 1] = -1.0
    A = sparse.csc_matrix(
        np.vstack([equal, press, turns.reshape(-1, size), cones.reshape(3 * n, size), ball])
    )
    P = sparse.diags([2.0, 2.0, *[2 * _EVEN] * (3 * n)], format="csc")
    kinds = [
        clarabel.ZeroConeT(6),
        clarabel.NonnegativeConeT(n + 2 * n * robot.joint_count),
        *[clarabel.SecondOrderConeT(3)] * (n + 1),
    ]
    limits = [np.full(2 * n * robot.joint_count, 1.0 - _IN_HAND)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    weight = robot.weight / unit
    for share in _SHARES if spec.margins.asked else _SHARES[-1:]:
        least = max(share * spec.margins.pressure * weight, spec.force.least_pressure / unit)
        reserve = share * spec.margins.friction * weight
        ends = np.zeros((n, 3))
        ends[:, 0] = -steep * reserve
        ball_ends = np.array([most, 0.0, 0.0])
        b = np.concatenate([-force, -moment, np.full(n, -least), *limits, ends.ravel(), ball_ends])
        solution = clarabel.DefaultSolver(P, np.zeros(size), A, b, kinds, settings).solve()
        if str(solution.status) in _SOLVED:
            shift = np.array([*solution.x[:2], 0.0])
            return shift if np.linalg.norm(shift) > _NONE else np.zeros(3)
    return np.zeros(3)


def body_way(rounds: Rounds, instants: Instants) -> tuple[Array, Array]:
    """Poses com and rpy (S, P, 3) along the way that the instants take.

    From the start to the first lift, and from each placing to the next lift or the end.
    """
    com = np.concatenate([rounds.com[:1], instants.com[::2], instants.com[-1:]])
    rpy = np.concatenate([rounds.rpy[:1], instants.rpy[::2], instants.rpy[-1:]])
    share = np.linspace(0.0, 1.0, _POSES)[:, None]
    ways = [x[:-1, None] + share * np.diff(x, axis=0)[:, None] for x in (com, rpy)]
    return ways[0], ways[1]
