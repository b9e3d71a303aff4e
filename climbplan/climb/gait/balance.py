"""Where the body stands before a limb is lifted: over the limbs that stay.

Between walls limbs brace, and a body that goes straight from posture to posture is held wherever it
is. On level ground it is held by its weight alone, which has to act between the toes that stand.
So before each lift the body leaves its straight way by the least level shift d for which contact
forces f of the standing limbs balance the load (F, M) with the margins of the spec:

    minimise    |d|^2                                  |d| <= posture.steps.shift_max
    such that   sum f = -F,   sum (p - c) x f + d x F = -M
                |f_t| <= mu / S_mu (n . f - friction margin),   n . f >= pressure margin
                |J^T f| <= torque limits / S_tau
                n . J D f >= depth margin

which is a second-order cone program, as the load, and so the sum of all f, is known. Where limbs
have masses, their weight is part of M and of torques, linear in d about the last shift, and forces
are asked for twice: for the lifted limb above the place that it leaves and above where it goes.
Jacobians are those of the body on its way. Where the forces found would be too much for motors of
the shifted body, whose legs are bent otherwise, or where there are none, programs follow one
another, each with the Jacobians of the last shift, near to it, and with torques beyond the limits
at a price. On slopes, stairs and walls it is the same problem. Bounds of commands and stability are
left to the force planner, joint bounds to the exact kinematics. Where no shift keeps the whole
margins, less depth of commands is asked for, then half of the others, then none; where motors are
too weak then, the body goes to where they lack least, and the force planner says what conflicts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.gait.balance_program import NEARBY, NONE, Balanced, Lift
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import MotionScene

_SHARES = (1.0, 0.5, 0.0)  # of the margins, asked for in turn
_DEPTHS = (1.0, 0.75, 0.5, 0.25)  # of the depth of commands beside all others, in turn
_EXCESS = 10.0  # [m^2] price of torques of twice the limits
_WITHIN = 1e-4  # of the limits, that counts as none
_PROGRAMS = 14  # after one another, at most
_TRUST = 0.05  # [m] to which Jacobians are trusted
_STILL = 1e-3  # [m] by which the last shift differs
_CENTRINGS = 4  # programs, at most, in which limbs with masses follow the body
_POSES = 6  # looked at along the body's way from one lift to the next


def balancing_shifts(
    scene: MotionScene,
    lifts: Instants,
    most: float | None = None,
    narrower: float = 1.0,
    follow: bool = True,
    places: Instants | None = None,
) -> Array:
    """(L, 3) level shifts of the body [m] at instants with lifted limbs; zeros where none helps.

    lifts: L instants with the body on its straight way; their joint angles are not looked at.
    most: the largest shift if not the spec's; narrower: factor on friction; follow: programs after
    one another where one does not do; places: L instants with lifted limbs above the places that
    they go to, where these are known.
    """
    most = scene.spec.posture.steps.shift_max if most is None else most
    over = [lifts] if places is None or scene.robot.links is None else [lifts, places]
    return np.array(
        [_least_shift(Lift(scene, over, k, narrower), most, follow) for k in range(lifts.count)]
    )


def _least_shift(lift: Lift, most: float, follow: bool) -> Array:
    """(3,) for one instant."""
    margins = lift.scene.spec.margins.asked or lift.scene.robot.sole is not None
    whole = lift
    best: tuple[float, Array] = np.inf, np.zeros(2)
    deep = _at_depth(lift, most)
    if deep is not None:
        return deep
    for share in _SHARES if margins else _SHARES[-1:]:
        lift = whole.pressed_within(share)
        found = _at_once(lift, share, most)
        if found is not None and (
            not follow or lift.excess(lift.posture(found.shift), found.force) <= 0
        ):
            best = 0.0, found.shift
            break
        if not follow:
            continue
        lack, shift = _followed(lift, share, most)
        if lack < best[0]:
            best = lack, shift
        if lack <= _WITHIN:
            break
    shift = np.array([*best[1], 0.0])
    return shift if np.linalg.norm(shift) > NONE else np.zeros(3)


def _at_depth(lift: Lift, most: float) -> Array | None:
    """(3,) the least shift with all margins of pressure and friction and commands inside surfaces.

    As deep as can be had of what the spec asks; None where none of it can at once.
    """
    margins = lift.scene.spec.margins
    asked = margins.asked and margins.depth > 0
    for share in _DEPTHS if asked else ():
        one = lift.pressed_within(1.0).commanded(share * margins.depth)
        found = _at_once(one, 1.0, most)
        if found is not None and one.excess(one.posture(found.shift), found.force) <= 0:
            return np.array([*found.shift, 0.0])
    return None


def _at_once(lift: Lift, share: float, most: float) -> Balanced | None:
    """The least shift with the Jacobians of the body on its way; None where there is none.

    Limbs with masses come along by what they do near the shift that was found last.
    """
    at = np.zeros(2)
    way = lift.posture(at)
    found = lift.solved(way, share, np.zeros(2), most, most, 0.0)
    if lift.scene.robot.links is None:
        return found
    for _ in range(_CENTRINGS):
        if found is None or np.linalg.norm(found.shift - at) < NEARBY:
            break
        at = found.shift
        near = replace(lift.posture(at), jacobian=way.jacobian)
        found = lift.solved(near, share, np.zeros(2), most, most, 0.0)
    return found


def _followed(lift: Lift, share: float, most: float) -> tuple[float, Array]:
    """What the torque limits lack at the end of programs after one another, and the shift (2,)."""
    at, trust = np.zeros(2), most
    best: tuple[float, Array] = np.inf, at
    for _ in range(_PROGRAMS):
        posture = lift.posture(at)
        here = lift.solved(posture, share, at, 0.0, most, _EXCESS) if posture.reached else None
        lack = np.inf if here is None else max(here.excess, 0.0)
        nearer = lack > _WITHIN or np.linalg.norm(at) < np.linalg.norm(best[1])
        if lack < best[0] - _WITHIN or (lack <= _WITHIN and nearer):
            best = lack, at
        elif np.isfinite(best[0]):
            trust *= 0.5
            at = best[1]
            posture = lift.posture(at)
        aim = lift.solved(posture, share, at, trust, most, _EXCESS)
        if aim is None or np.linalg.norm(aim.shift - at) < _STILL:
            break
        at, trust = aim.shift, min(trust, _TRUST)
    return best


def body_way(rounds: Rounds, instants: Instants) -> tuple[Array, Array]:
    """Poses com and rpy (S, P, 3) along the way that the instants take.

    From the start to the first lift, and from each placing to the next lift or the end.
    """
    com = np.concatenate([rounds.com[:1], instants.com[::2], instants.com[-1:]])
    rpy = np.concatenate([rounds.rpy[:1], instants.rpy[::2], instants.rpy[-1:]])
    share = np.linspace(0.0, 1.0, _POSES)[:, None]
    ways = [x[:-1, None] + share * np.diff(x, axis=0)[:, None] for x in (com, rpy)]
    return ways[0], ways[1]
