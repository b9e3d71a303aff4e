"""Where the body stands before a limb is lifted: over the limbs that stay.

Between walls limbs brace, and a body that goes straight from posture to posture is held wherever it
is. On level ground it is held by its weight alone, which has to act between the toes that stand.
So before each lift the body leaves its straight way by the least level shift d for which contact
forces f of the standing limbs balance the load (F, M) with the margins of the spec:

    minimise    |d|^2                                  |d| <= posture.steps.shift_max
    such that   sum f = -F,   sum (p - c) x f + d x F = -M
                |f_t| <= mu / S_mu (n . f - friction margin),   n . f >= pressure margin
                |J^T f| <= torque limits / S_tau

which is a second-order cone program, as the load, and so the sum of all f, is known. Where limbs
have masses, their weight is part of M, linear in d about the last shift, and forces are asked for
twice: for the lifted limb above the place that it leaves and above where it goes. Jacobians are
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
from climbplan.mechanics.equilibrium import grasp_matrix, link_torques, weight_moment
from climbplan.mechanics.friction import contact_frame
from climbplan.robots.kinematics import by_point, point_jacobian, pushed_points, standing_inverse
from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain

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
_NEARBY = 1e-3  # [m] from which the weight's moment is followed by its difference
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
        [_least_shift(_Lift(scene, over, k, narrower), most, follow) for k in range(lifts.count)]
    )


def _least_shift(lift: _Lift, most: float, follow: bool) -> Array:
    """(3,) for one instant."""
    margins = lift.scene.spec.margins.asked or lift.scene.robot.sole is not None
    whole = lift
    best: tuple[float, Array] = np.inf, np.zeros(2)
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
    return shift if np.linalg.norm(shift) > _NONE else np.zeros(3)


def _at_once(lift: _Lift, share: float, most: float) -> _Balanced | None:
    """The least shift with the Jacobians of the body on its way; None where there is none.

    Limbs with masses come along by what they do near the shift that was found last.
    """
    at = np.zeros(2)
    way = lift.posture(at)
    found = lift.solved(way, share, np.zeros(2), most, most, 0.0)
    if lift.scene.robot.links is None:
        return found
    for _ in range(_CENTRINGS):
        if found is None or np.linalg.norm(found.shift - at) < _NEARBY:
            break
        at = found.shift
        near = replace(lift.posture(at), jacobian=way.jacobian)
        found = lift.solved(near, share, np.zeros(2), most, most, 0.0)
    return found


def _followed(lift: _Lift, share: float, most: float) -> tuple[float, Array]:
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


@dataclass(frozen=True)
class _Balanced:
    """A shift and its forces."""

    shift: Array  # (2,) [m]
    force: Array  # (P, 3 n) in units of the load
    excess: float  # of the torque limits


@dataclass(frozen=True)
class _Posture:
    """Limbs of the body shifted by `at`, P phases of what is lifted."""

    at: Array  # (2,) [m]
    jacobian: Array  # (n, 3, J) of points that are pushed, world
    reached: bool  # whether standing limbs reach
    moment: Array  # (P, 3) of the weight about the body's origin, by units of the load
    slope: Array  # (P, 2, 3) of it, by the shift
    links: Array  # (L, J) torque / limit over S_tau of the links' own weight, of standing limbs


class _Lift:
    """One instant with limbs lifted, in one phase of the lift or in P."""

    def __init__(self, scene: MotionScene, phases: list[Instants], k: int, narrower: float) -> None:
        self.scene, self.phases, self.k, self.narrower = scene, phases, k, narrower
        self.lifts = lifts = phases[0]
        spec, robot = scene.spec, scene.robot
        self.stands = np.flatnonzero(lifts.contact[k])
        # Points at which standing limbs are pushed, each with its limb's place among these
        stands = np.flatnonzero(by_point(robot, lifts.contact[k], 0))
        self.points = len(stands) // max(len(self.stands), 1)
        self.limb_of = np.repeat(np.arange(len(self.stands)), self.points)
        load = lifts.external_wrench[k].copy()
        load[2] -= robot.weight
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
        return _Lift(scene, self.phases, self.k, self.narrower)

    def posture(self, shift: Array) -> _Posture:
        """Limbs of the body shifted by (2,).

        Jacobians are zero for a limb out of reach: torques are left open, as another shift may mend
        it.
        """
        robot, k = self.scene.robot, self.k
        off = np.array([*shift, 0.0]) + _NEARBY * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
        if robot.links is None:
            off = off[:1]
        count = len(self.phases), len(off)
        com = np.broadcast_to(self.lifts.com[k] + off, (*count, 3))
        rpy = np.broadcast_to(self.lifts.rpy[k], (*count, 3))
        toes, normal = (
            np.stack([np.broadcast_to(vars(one)[name][k], (len(off), *one.toes[k].shape))
                      for one in self.phases])
            for name in ("toes", "normal")
        )  # fmt: skip
        angles = standing_inverse(robot, com, rpy, toes, normal).best()
        first = angles[:1, 0]
        out = np.asarray(np.isnan(first).any(axis=-1))
        jacobian = point_jacobian(robot, rpy[0, :1], np.nan_to_num(first), normal[0, :1])
        jacobian[by_point(robot, out, 1)] = 0.0
        standing = by_point(robot, self.lifts.contact[k], 0)
        moment, slope = np.zeros((count[0], 3)), np.zeros((count[0], 2, 3))
        links = np.zeros((len(self.stands), robot.joint_count))
        if robot.links is not None:
            bent = self._bent(angles)
            own = link_torques(robot, rpy[0, 0], bent[0, 0])[self.stands]
            links = own * self.scene.spec.force.safety_torque / robot.max_torque[self.stands]
            by_shift = weight_moment(robot, rpy, bent) / self.unit
            moment = by_shift[:, 0]
            slope = (by_shift[:, 1:] - by_shift[:, :1]) / _NEARBY
        reached = not bool(out[0][self.stands].any())
        return _Posture(np.asarray(shift), jacobian[0][standing], reached, moment, slope, links)

    def _bent(self, angles: Array) -> Array:
        """Angles (P, 3, N, J), of limbs out of reach those in which the robot stands."""
        chain = self.scene.robot.mechanism
        assert isinstance(chain, SerialChain)
        here = angles[:, :1]
        lost = np.isnan(here).any(axis=-1, keepdims=True)
        here = np.where(lost, chain.posture, here)
        return np.where(lost | np.isnan(angles).any(axis=-1, keepdims=True), here, angles)

    def _share(self, jacobian: Array) -> Array:
        """(n, 3, J) of torque limits over S_tau, by units of the load."""
        limit = self.scene.robot.max_torque[self.stands][self.limb_of, None]
        share: Array = jacobian * self.unit * self.scene.spec.force.safety_torque / limit
        return share

    def excess(self, posture: _Posture, force: Array) -> float:
        """What forces (P, 3 n) take beyond the torque limits; infinite out of reach."""
        pushes = force.reshape(len(force), -1, 3)
        taken = np.einsum("nij,pni->pnj", self._share(posture.jacobian), pushes)
        if self.points > 1:
            taken = taken.reshape(len(force), len(self.stands), self.points, -1).sum(axis=2)
        most = float(np.abs(taken + posture.links).max())
        return most - 1.0 if posture.reached else np.inf

    def _phased(self, rows: Array) -> Array:
        """Rows (R, 3 + 3 n) of each phase, (P R, 3 + 3 n P): the same shift, forces of its own."""
        count, each = len(self.phases), 3 * self.n
        out = np.zeros((count, len(rows), _FORCES + count * each))
        out[:, :, :_FORCES] = rows[:, :_FORCES]
        for phase in range(count):
            out[phase, :, _FORCES + phase * each : _FORCES + (phase + 1) * each] = rows[:, _FORCES:]
        return out.reshape(count * len(rows), -1)

    def solved(
        self, posture: _Posture, share: float, about: Array, trust: float, most: float, price: float
    ) -> _Balanced | None:
        """The least shift with a share of the margins, None where there is none.

        about: shift (2,) that it is no farther from than `trust` [m]; most: its size [m]; price: of
        torques beyond the limits, none of which are allowed at 0.
        """
        spec, size, n, phases = self.scene.spec, self.size, self.n, len(self.phases)
        joints = self.scene.robot.joint_count
        taken = self._share(posture.jacobian)
        limbs = len(self.stands)
        turns = np.zeros((limbs, 2, joints, size))
        for i, limb in enumerate(self.limb_of):
            own = slice(_FORCES + 3 * i, _FORCES + 3 * i + 3)
            turns[limb, 0][:, own], turns[limb, 1][:, own] = taken[i].T, -taken[i].T
        turns[..., 2] = -1.0
        equal = self._phased(self.equal)
        equal.reshape(phases, 6, -1)[:, 3:, :2] += np.swapaxes(posture.slope, 1, 2)
        load = np.tile(self.load, (phases, 1))
        load[:, 3:] += posture.moment - posture.at @ posture.slope
        whole = equal.shape[1]
        over = np.zeros((1, whole))
        over[0, 2] = -1.0 if price else 0.0
        none = np.zeros((1, whole))
        none[0, 2] = 0.0 if price else 1.0
        balls = np.zeros((2, 3, whole))
        balls[:, 1, 0] = balls[:, 2, 1] = -1.0
        A = sparse.csc_matrix(
            np.vstack(
                [equal, none, self._phased(self.press), self._phased(turns.reshape(-1, size)), over,
                 self._phased(self.cones.reshape(3 * n, size)), balls.reshape(6, whole)]
            )
        )  # fmt: skip
        P = sparse.diags([2.0, 2.0, 0.0, *[2 * _EVEN] * (whole - _FORCES)], format="csc")
        q = np.zeros(whole)
        q[2] = price
        room = np.stack([-posture.links, posture.links], axis=1) + (1.0 - _IN_HAND)
        torques = np.tile(room.ravel(), phases)
        kinds = [
            clarabel.ZeroConeT(6 * phases + 1),
            clarabel.NonnegativeConeT(n * phases + len(torques) + 1),
            *[clarabel.SecondOrderConeT(3)] * (n * phases + 2),
        ]
        weight = self.scene.robot.weight / self.unit / self.points
        asked = spec.force.least_pressure / self.unit / self.points
        least = max(share * spec.margins.pressure * weight, asked)
        ends = np.zeros((phases, n, 3))
        ends[..., 0] = -self.steep * share * spec.margins.friction * weight
        b = np.concatenate(
            [-load.ravel(), [0.0], np.full(n * phases, -least), torques,
             [0.0], ends.ravel(), [most, 0.0, 0.0], [trust + _NONE, *-about]]
        )  # fmt: skip
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        solution = clarabel.DefaultSolver(P, q, A, b, kinds, settings).solve()
        if str(solution.status) not in _SOLVED:
            return None
        x = np.array(solution.x)
        return _Balanced(x[:2], x[_FORCES:].reshape(phases, -1), float(x[2]))


def body_way(rounds: Rounds, instants: Instants) -> tuple[Array, Array]:
    """Poses com and rpy (S, P, 3) along the way that the instants take.

    From the start to the first lift, and from each placing to the next lift or the end.
    """
    com = np.concatenate([rounds.com[:1], instants.com[::2], instants.com[-1:]])
    rpy = np.concatenate([rounds.rpy[:1], instants.rpy[::2], instants.rpy[-1:]])
    share = np.linspace(0.0, 1.0, _POSES)[:, None]
    ways = [x[:-1, None] + share * np.diff(x, axis=0)[:, None] for x in (com, rpy)]
    return ways[0], ways[1]
