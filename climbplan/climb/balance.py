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
those of the body on its way. Where the forces found would be too much for motors of the shifted
body, whose legs are bent otherwise, or where there are none, programs follow one another, each with
the Jacobians of the last shift, near to it, and with torques beyond the limits at a price. On
slopes, stairs and walls it is the same problem. Commands and stability are left to the force
planner, joint bounds to the exact kinematics. Where no shift keeps the whole margins, half of them
are asked for, then none; where motors are too weak then, the body goes to where they lack least,
and the force planner says what conflicts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse

from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene import MotionScene
from climbplan.mechanics.equilibrium import grasp_matrix, total_load
from climbplan.mechanics.friction import contact_frame
from climbplan.robots.kinematics import by_point, point_jacobian, pushed_points, standing_inverse
from climbplan.robots.rotations import Array

_SHARES = (1.0, 0.5, 0.0)  # of the margins, asked for in turn
_EVEN = 1e-6  # [m^2] weight of the squared forces, in units of the load
_NONE = 1e-5  # [m] a shift that counts as none
_IN_HAND = 0.02  # of the torque limits, as Jacobians change with the shift
_EXCESS = 10.0  # [m^2] price of torques of twice the limits
_WITHIN = 1e-4  # of the limits, that counts as none
_PROGRAMS = 14  # after one another, at most
_TRUST = 0.05  # [m] to which Jacobians are trusted
_STILL = 1e-3  # [m] by which the last shift differs
_SOLVED = ("Solved", "AlmostSolved")
_FORCES = 3  # columns of the program before those of forces
_POSES = 6  # looked at along the body's way from one lift to the next


def balancing_shifts(
    scene: MotionScene,
    lifts: Instants,
    most: float | None = None,
    narrower: float = 1.0,
    follow: bool = True,
) -> Array:
    """(L, 3) level shifts of the body [m] at instants with lifted limbs; zeros where none helps.

    lifts: L instants with the body on its straight way; their joint angles are not looked at.
    most: the largest shift if not the spec's; narrower: factor on friction; follow: programs after
    one another where one does not do.
    """
    most = scene.spec.posture.steps.shift_max if most is None else most
    return np.array(
        [_least_shift(_Lift(scene, lifts, k, narrower), most, follow) for k in range(lifts.count)]
    )


def _least_shift(lift: _Lift, most: float, follow: bool) -> Array:
    """(3,) for one instant."""
    margins = lift.scene.spec.margins.asked or lift.scene.robot.sole is not None
    whole = lift
    best: tuple[float, Array] = np.inf, np.zeros(2)
    for share in _SHARES if margins else _SHARES[-1:]:
        lift = whole.pressed_within(share)
        way, _ = lift.jacobian(np.zeros(2))
        found = lift.solved(way, share, np.zeros(2), most, most, 0.0)
        if found is not None and (
            not follow or lift.excess(*lift.jacobian(found.shift), found.force) <= 0
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
    return shift if np.linalg.norm(shift) > _NONE else np.zeros(3)


def _followed(lift: _Lift, share: float, most: float) -> tuple[float, Array]:
    """What the torque limits lack at the end of programs after one another, and the shift (2,)."""
    at, trust = np.zeros(2), most
    best: tuple[float, Array] = np.inf, at
    for _ in range(_PROGRAMS):
        jacobian, reached = lift.jacobian(at)
        here = lift.solved(jacobian, share, at, 0.0, most, _EXCESS) if reached else None
        lack = np.inf if here is None else max(here.excess, 0.0)
        nearer = lack > _WITHIN or np.linalg.norm(at) < np.linalg.norm(best[1])
        if lack < best[0] - _WITHIN or (lack <= _WITHIN and nearer):
            best = lack, at
        elif np.isfinite(best[0]):
            trust *= 0.5
            at = best[1]
            jacobian, _ = lift.jacobian(at)
        aim = lift.solved(jacobian, share, at, trust, most, _EXCESS)
        if aim is None or np.linalg.norm(aim.shift - at) < _STILL:
            break
        at, trust = aim.shift, min(trust, _TRUST)
    return best


@dataclass(frozen=True)
class _Balanced:
    """A shift and its forces."""

    shift: Array  # (2,) [m]
    force: Array  # (3 n,) in units of the load
    excess: float  # of the torque limits


class _Lift:
    """One instant with limbs lifted."""

    def __init__(self, scene: MotionScene, lifts: Instants, k: int, narrower: float) -> None:
        self.scene, self.lifts, self.k, self.narrower = scene, lifts, k, narrower
        spec, robot = scene.spec, scene.robot
        self.stands = np.flatnonzero(lifts.contact[k])
        # Points at which standing limbs are pushed, each with its limb's place among these
        stands = np.flatnonzero(by_point(robot, lifts.contact[k], 0))
        self.points = len(stands) // max(len(self.stands), 1)
        self.limb_of = np.repeat(np.arange(len(self.stands)), self.points)
        load = total_load(robot, lifts.external_wrench[k])
        self.unit = unit = max(float(np.linalg.norm(load[:3])), 1e-9)
        self.n = n = len(stands)
        # Shift, excess, forces in units of the load
        self.size = size = _FORCES + 3 * n
        self.load = load / unit
        self.equal = np.zeros((6, size))
        normal = by_point(robot, lifts.normal[k], 0)[stands]
        touching = pushed_points(robot, lifts.toes[k], lifts.normal[k])[stands]
        self.equal[:, _FORCES:] = grasp_matrix(touching - lifts.com[k])
        self.equal[3:, 0] = np.cross([1.0, 0.0, 0.0], self.load[:3])
        self.equal[3:, 1] = np.cross([0.0, 1.0, 0.0], self.load[:3])
        frame = contact_frame(normal).axes  # (n, 3, 3)
        self.steep = narrower * by_point(robot, lifts.mu[k], 0)[stands] / spec.force.safety_friction
        self.press = np.zeros((n, size))
        self.cones = np.zeros((n, 3, size))
        for i in range(n):
            own = slice(_FORCES + 3 * i, _FORCES + 3 * i + 3)
            self.press[i, own] = -frame[i, 0]
            self.cones[i, :, own] = -frame[i]
            self.cones[i, 0, own] *= self.steep[i]

    def pressed_within(self, share: float) -> _Lift:
        """The same with a share of the margin of soles; itself for feet that are not flat."""
        margin = share * self.scene.spec.margins.sole
        if self.scene.robot.sole is None or margin == 0:
            return self
        scene = replace(self.scene, robot=self.scene.robot.pressed_within(margin))
        return _Lift(scene, self.lifts, self.k, self.narrower)

    def jacobian(self, shift: Array) -> tuple[Array, bool]:
        """(n, 3, J) of the body shifted by (2,), world, and whether standing limbs reach.

        Zero for a limb out of reach: torques are left open, as another shift may mend it.
        """
        lifts, k = self.lifts, self.k
        com = lifts.com[k : k + 1] + np.array([*shift, 0.0])
        rpy = lifts.rpy[k : k + 1]
        robot = self.scene.robot
        normal = lifts.normal[k : k + 1]
        angles = standing_inverse(robot, com, rpy, lifts.toes[k : k + 1], normal).best()
        out = np.asarray(np.isnan(angles).any(axis=-1))
        jacobian = point_jacobian(robot, rpy, np.nan_to_num(angles), normal)
        jacobian[by_point(robot, out, 1)] = 0.0
        standing = by_point(robot, lifts.contact[k], 0)
        return jacobian[0][standing], not bool(out[0][self.stands].any())

    def _share(self, jacobian: Array) -> Array:
        """(n, 3, J) of torque limits over S_tau, by units of the load."""
        limit = self.scene.robot.max_torque[self.stands][self.limb_of, None]
        share: Array = jacobian * self.unit * self.scene.spec.force.safety_torque / limit
        return share

    def excess(self, jacobian: Array, reached: bool, force: Array) -> float:
        """What forces (3 n,) take beyond the torque limits of a posture; infinite out of reach."""
        taken = np.einsum("nij,ni->nj", self._share(jacobian), force.reshape(-1, 3))
        if self.points > 1:
            taken = taken.reshape(len(self.stands), self.points, -1).sum(axis=1)
        return float(np.abs(taken).max()) - 1.0 if reached else np.inf

    def solved(
        self, jacobian: Array, share: float, about: Array, trust: float, most: float, price: float
    ) -> _Balanced | None:
        """The least shift with a share of the margins, None where there is none.

        about: shift (2,) that it is no farther from than `trust` [m]; most: its size [m]; price: of
        torques beyond the limits, none of which are allowed at 0.
        """
        spec, size, n = self.scene.spec, self.size, self.n
        joints = self.scene.robot.joint_count
        taken = self._share(jacobian)
        limbs = len(self.stands)
        turns = np.zeros((limbs, 2, joints, size))
        for i, limb in enumerate(self.limb_of):
            own = slice(_FORCES + 3 * i, _FORCES + 3 * i + 3)
            turns[limb, 0][:, own], turns[limb, 1][:, own] = taken[i].T, -taken[i].T
        turns[..., 2] = -1.0
        over = np.zeros((1, size))
        over[0, 2] = -1.0 if price else 0.0
        none = np.zeros((1, size))
        none[0, 2] = 0.0 if price else 1.0
        balls = np.zeros((2, 3, size))
        balls[:, 1, 0] = balls[:, 2, 1] = -1.0
        A = sparse.csc_matrix(
            np.vstack(
                [self.equal, none, self.press, turns.reshape(-1, size), over,
                 self.cones.reshape(3 * n, size), balls.reshape(6, size)]
            )
        )  # fmt: skip
        P = sparse.diags([2.0, 2.0, 0.0, *[2 * _EVEN] * (3 * n)], format="csc")
        q = np.zeros(size)
        q[2] = price
        kinds = [
            clarabel.ZeroConeT(7),
            clarabel.NonnegativeConeT(n + 2 * limbs * joints + 1),
            *[clarabel.SecondOrderConeT(3)] * (n + 2),
        ]
        weight = self.scene.robot.weight / self.unit / self.points
        asked = spec.force.least_pressure / self.unit / self.points
        least = max(share * spec.margins.pressure * weight, asked)
        ends = np.zeros((n, 3))
        ends[:, 0] = -self.steep * share * spec.margins.friction * weight
        b = np.concatenate(
            [-self.load, [0.0], np.full(n, -least), np.full(2 * limbs * joints, 1.0 - _IN_HAND),
             [0.0], ends.ravel(), [most, 0.0, 0.0], [trust + _NONE, *-about]]
        )  # fmt: skip
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        solution = clarabel.DefaultSolver(P, q, A, b, kinds, settings).solve()
        if str(solution.status) not in _SOLVED:
            return None
        x = np.array(solution.x)
        return _Balanced(x[:2], x[_FORCES:], float(x[2]))


def body_way(rounds: Rounds, instants: Instants) -> tuple[Array, Array]:
    """Poses com and rpy (S, P, 3) along the way that the instants take.

    From the start to the first lift, and from each placing to the next lift or the end.
    """
    com = np.concatenate([rounds.com[:1], instants.com[::2], instants.com[-1:]])
    rpy = np.concatenate([rounds.rpy[:1], instants.rpy[::2], instants.rpy[-1:]])
    share = np.linspace(0.0, 1.0, _POSES)[:, None]
    ways = [x[:-1, None] + share * np.diff(x, axis=0)[:, None] for x in (com, rpy)]
    return ways[0], ways[1]
