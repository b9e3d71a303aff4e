"""Shift the body over the standing limbs before a limb is lifted.

Limbs brace between walls, and support a body anywhere on the straight path between postures. On
level ground the weight has to act between the standing toes. Before each lift the body therefore
leaves its straight path by the smallest level shift d for which contact forces f of the standing
limbs balance the load (F, M) with the margins of the spec:

    minimise    |d|^2                                  |d| <= posture.steps.com_shift_max
    such that   sum f = -F,   sum (p - c) x f + d x F = -M
                |f_t| <= mu / S_mu (n . f - friction margin),   n . f >= pressure margin
                |J^T f| <= torque limits / S_tau
                n . J D f >= depth margin

This is a second-order cone program, as the load and thus the sum of all f is known. If limbs have
masses their weight is part of M and of torques, linear in d about the last shift. Forces then are
required twice: with the lifted limb above the place that it leaves and above its next one.

Jacobians are those of the body on its straight path. If the forces exceed the torque limits of the
shifted body, or if there are none, the program is solved sequentially: with the Jacobians of the
last shift, in a trust region about it, and with a price on torques beyond the limits. Slopes,
stairs and walls are the same problem. The force planner bounds commands and stability, the exact
kinematics bounds joints.

If no shift keeps all margins, less depth of commands is required, then half of the other margins,
then none. If motors are too weak even then, the body goes to the place of smallest excess, and the
force planner reports the conflict.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.gait.balance_program import (
    DIFFERENCE_STEP,
    ZERO_SHIFT,
    BalanceSolution,
    LiftBalance,
)
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import MotionScene

_MARGIN_FRACTIONS = (1.0, 0.5, 0.0)  # of the margins, required in turn
_DEPTH_FRACTIONS = (
    1.0,
    0.75,
    0.5,
    0.25,
)  # of the depth of commands with all other margins, in turn
_EXCESS_PRICE = 10.0  # [m^2] price of torques of twice the limits
_EXCESS_TOLERANCE = 1e-4  # of the limits
_MAX_PROGRAMS = 14  # of a sequence
_TRUST_RADIUS = 0.05  # [m] after the first step
_SHIFT_TOLERANCE = 1e-3  # [m] between the last shifts
_MAX_CENTRING_PROGRAMS = 4  # in which the limbs' weight is updated
_NUM_POSES = 6  # along the body's path from one lift to the next


def find_balancing_shifts(
    scene: MotionScene,
    lifts: Instants,
    max_shift: float | None = None,
    cone_scale: float = 1.0,
    allow_sequence: bool = True,
    places: Instants | None = None,
) -> Array:
    """Find level shifts (L, 3) of the body at instants with lifted limbs [m]; zero if none helps.

    Args:
        scene: The scene.
        lifts: L instants with the body on its straight path; joint angles are not used.
        max_shift: Largest shift [m]; None takes the spec's.
        cone_scale: Factor on friction.
        allow_sequence: Whether to solve programs sequentially if one does not suffice.
        places: L instants with lifted limbs above their next places; None if unknown.
    """
    max_shift = scene.spec.posture.steps.com_shift_max if max_shift is None else max_shift
    over = [lifts] if places is None or scene.robot.links is None else [lifts, places]
    return np.array(
        [
            _find_smallest_shift(LiftBalance(scene, over, k, cone_scale), max_shift, allow_sequence)
            for k in range(lifts.count)
        ]
    )


def _find_smallest_shift(lift: LiftBalance, max_shift: float, allow_sequence: bool) -> Array:
    """Find the smallest shift (3,) for one instant [m]."""
    margins = lift.scene.spec.margins.asked or lift.scene.robot.sole is not None
    original = lift
    best: tuple[float, Array] = np.inf, np.zeros(2)
    deep_shift = _find_shift_with_depth(lift, max_shift)
    if deep_shift is not None:
        return deep_shift
    for margin_fraction in _MARGIN_FRACTIONS if margins else _MARGIN_FRACTIONS[-1:]:
        lift = original.with_sole_margin(margin_fraction)
        solution = _solve_linearised(lift, margin_fraction, max_shift)
        if solution is not None and (
            not allow_sequence
            or lift.compute_excess(lift.compute_posture(solution.shift), solution.force) <= 0
        ):
            best = 0.0, solution.shift
            break
        if not allow_sequence:
            continue
        excess, shift = _solve_sequentially(lift, margin_fraction, max_shift)
        if excess < best[0]:
            best = excess, shift
        if excess <= _EXCESS_TOLERANCE:
            break
    shift = np.array([*best[1], 0.0])
    return shift if np.linalg.norm(shift) > ZERO_SHIFT else np.zeros(3)


def _find_shift_with_depth(lift: LiftBalance, max_shift: float) -> Array | None:
    """Find the smallest shift (3,) with all margins and the largest feasible command depth [m].

    None if no fraction of the depth is feasible in one program.
    """
    margins = lift.scene.spec.margins
    is_required = margins.asked and margins.depth > 0
    for fraction in _DEPTH_FRACTIONS if is_required else ():
        candidate = lift.with_sole_margin(1.0).with_depth(fraction * margins.depth)
        solution = _solve_linearised(candidate, 1.0, max_shift)
        if (
            solution is not None
            and candidate.compute_excess(candidate.compute_posture(solution.shift), solution.force)
            <= 0
        ):
            return np.array([*solution.shift, 0.0])
    return None


def _solve_linearised(
    lift: LiftBalance, margin_fraction: float, max_shift: float
) -> BalanceSolution | None:
    """Solve with the Jacobians of the body on its straight path; None without a solution.

    The weight of limbs is linearised about the last shift and updated.
    """
    shift = np.zeros(2)
    straight = lift.compute_posture(shift)
    solution = lift.solve(straight, margin_fraction, np.zeros(2), max_shift, max_shift, 0.0)
    if lift.scene.robot.links is None:
        return solution
    for _ in range(_MAX_CENTRING_PROGRAMS):
        if solution is None or np.linalg.norm(solution.shift - shift) < DIFFERENCE_STEP:
            break
        shift = solution.shift
        linearised = replace(lift.compute_posture(shift), jacobian=straight.jacobian)
        solution = lift.solve(linearised, margin_fraction, np.zeros(2), max_shift, max_shift, 0.0)
    return solution


def _solve_sequentially(
    lift: LiftBalance, margin_fraction: float, max_shift: float
) -> tuple[float, Array]:
    """Solve programs sequentially; return the excess of torques and the shift (2,) [m]."""
    shift, trust = np.zeros(2), max_shift
    best: tuple[float, Array] = np.inf, shift
    for _ in range(_MAX_PROGRAMS):
        posture = lift.compute_posture(shift)
        current_solution = (
            lift.solve(posture, margin_fraction, shift, 0.0, max_shift, _EXCESS_PRICE)
            if posture.reached
            else None
        )
        excess = np.inf if current_solution is None else max(current_solution.excess, 0.0)
        is_nearer = excess > _EXCESS_TOLERANCE or np.linalg.norm(shift) < np.linalg.norm(best[1])
        if excess < best[0] - _EXCESS_TOLERANCE or (excess <= _EXCESS_TOLERANCE and is_nearer):
            best = excess, shift
        elif np.isfinite(best[0]):
            trust *= 0.5
            shift = best[1]
            posture = lift.compute_posture(shift)
        next_solution = lift.solve(posture, margin_fraction, shift, trust, max_shift, _EXCESS_PRICE)
        if next_solution is None or np.linalg.norm(next_solution.shift - shift) < _SHIFT_TOLERANCE:
            break
        shift, trust = next_solution.shift, min(trust, _TRUST_RADIUS)
    return best


def sample_body_path(rounds: Rounds, instants: Instants) -> tuple[Array, Array]:
    """Sample poses com and rpy (S, P, 3) along the body's path through the instants.

    Segments lead from the start to the first lift, and from each placing to the next lift.
    """
    com = np.concatenate([rounds.com[:1], instants.com[::2], instants.com[-1:]])
    rpy = np.concatenate([rounds.rpy[:1], instants.rpy[::2], instants.rpy[-1:]])
    fractions = np.linspace(0.0, 1.0, _NUM_POSES)[:, None]
    paths = [x[:-1, None] + fractions * np.diff(x, axis=0)[:, None] for x in (com, rpy)]
    return paths[0], paths[1]
