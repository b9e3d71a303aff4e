"""The cone program of a lift: the least shift of the body with which standing limbs hold it.

Stated in `balance.py`, which solves it once or several times, each about the limbs as the shift
before had bent them.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.mechanics.equilibrium import grasp_matrix, link_torques, weight_moment
from climbplan.mechanics.friction import contact_frame
from climbplan.mechanics.stiffness import commanded_depth, joint_bending
from climbplan.robots.kinematics import (
    by_point,
    contact_jacobian,
    point_jacobian,
    pushed_points,
    standing_inverse,
)
from climbplan.robots.serial_chain import SerialChain

NONE = 1e-5  # [m] a shift that counts as none
NEARBY = 1e-3  # [m] from which the weight's moment is followed by its difference
_EVEN = 1e-6  # [m^2] weight of the squared forces, in units of the load
_IN_HAND = 0.02  # of the torque limits, as Jacobians change with the shift
_SOLVED = ("Solved", "AlmostSolved")
_FORCES = 3  # columns of the program before those of forces


@dataclass(frozen=True)
class Balanced:
    """A shift and its forces."""

    shift: Array  # (2,) [m]
    force: Array  # (P, 3 n) in units of the load
    excess: float  # of the torque limits


@dataclass(frozen=True)
class LiftPosture:
    """Limbs of the body shifted by `at`, P phases of what is lifted."""

    at: Array  # (2,) [m]
    jacobian: Array  # (n, 3, J) of points that are pushed, world
    reached: bool  # whether standing limbs reach
    moment: Array  # (P, 3) of the weight about the body's origin, by units of the load
    slope: Array  # (P, 2, 3) of it, by the shift
    links: Array  # (L, J) torque / limit over S_tau of the links' own weight, of standing limbs
    inward: Array  # (L, n, 3) how deep toes are commanded into surfaces, by units of the load [m]


class Lift:
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
        self.depth = 0.0  # [m] in their surfaces, at which commands of standing limbs are asked for
        # Shift, excess, forces in units of the load
        self.size = size = _FORCES + 3 * n
        self.load = load / unit
        self.equal = np.zeros((6, size))
        normal = by_point(robot, lifts.normal[k], 0)[stands]
        self.touching = pushed_points(robot, lifts.toes[k], lifts.normal[k])
        self.equal[:, _FORCES:] = grasp_matrix(self.touching[stands] - lifts.com[k])
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

    def pressed_within(self, share: float) -> Lift:
        """The same with a share of the margin of soles; itself for feet that are not flat."""
        margin = share * self.scene.spec.margins.sole
        if self.scene.robot.sole is None or margin == 0:
            return self
        scene = replace(self.scene, robot=self.scene.robot.pressed_within(margin))
        return Lift(scene, self.phases, self.k, self.narrower)

    def commanded(self, depth: float) -> Lift:
        """The same with commands so deep in their surfaces [m]."""
        other = copy(self)
        other.depth = depth
        return other

    def posture(self, shift: Array) -> LiftPosture:
        """Limbs of the body shifted by (2,).

        Jacobians are zero for a limb out of reach: torques are left open, as another shift may mend
        it.
        """
        robot, k = self.scene.robot, self.k
        off = np.array([*shift, 0.0]) + NEARBY * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
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
        inward = np.zeros((len(self.stands), self.n, 3))
        if self.depth > 0:
            pose = rpy[0, :1], np.nan_to_num(first), normal[0, :1]
            arms = self.touching - self.lifts.com[k] - off[0]
            sag = self.scene.spec.force.sag == "compensated"
            bending = joint_bending(robot, jacobian, arms[None], standing[None], sag)
            of_toes = contact_jacobian(robot, *pose)
            depths = self.unit * commanded_depth(of_toes, normal[0, :1], bending)[0]
            inward = depths[self.stands][:, standing]
        moment, slope = np.zeros((count[0], 3)), np.zeros((count[0], 2, 3))
        links = np.zeros((len(self.stands), robot.joint_count))
        if robot.links is not None:
            bent = self._bent(angles)
            own = link_torques(robot, rpy[0, 0], bent[0, 0])[self.stands]
            links = own * self.scene.spec.force.safety_torque / robot.max_torque[self.stands]
            by_shift = weight_moment(robot, rpy, bent) / self.unit
            moment = by_shift[:, 0]
            slope = (by_shift[:, 1:] - by_shift[:, :1]) / NEARBY
        reached = not bool(out[0][self.stands].any())
        return LiftPosture(
            np.asarray(shift), jacobian[0][standing], reached, moment, slope, links, inward
        )

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

    def excess(self, posture: LiftPosture, force: Array) -> float:
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
        return out.reshape(count * len(rows), out.shape[-1])

    def solved(
        self,
        posture: LiftPosture,
        share: float,
        about: Array,
        trust: float,
        most: float,
        price: float,
    ) -> Balanced | None:
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
        # Depths by what is asked for, as rows of the size of others
        deep = np.zeros((limbs if self.depth > 0 else 0, size))
        if len(deep):
            deep[:, _FORCES:] = -posture.inward.reshape(limbs, -1) / self.depth
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
                [equal, none, self._phased(self.press), self._phased(turns.reshape(-1, size)),
                 self._phased(deep), over,
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
            clarabel.NonnegativeConeT(n * phases + len(torques) + len(deep) * phases + 1),
            *[clarabel.SecondOrderConeT(3)] * (n * phases + 2),
        ]
        weight = self.scene.robot.weight / self.unit / self.points
        asked = spec.force.least_pressure / self.unit / self.points
        least = max(share * spec.margins.pressure * weight, asked)
        ends = np.zeros((phases, n, 3))
        ends[..., 0] = -self.steep * share * spec.margins.friction * weight
        b = np.concatenate(
            [-load.ravel(), [0.0], np.full(n * phases, -least), torques,
             np.full(len(deep) * phases, -1.0),
             [0.0], ends.ravel(), [most, 0.0, 0.0], [trust + NONE, *-about]]
        )  # fmt: skip
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        solution = clarabel.DefaultSolver(P, q, A, b, kinds, settings).solve()
        if str(solution.status) not in _SOLVED:
            return None
        x = np.array(solution.x)
        return Balanced(x[:2], x[_FORCES:].reshape(phases, -1), float(x[2]))
