"""The second-order cone program of a lift: the smallest body shift that standing limbs support.

`balance.py` states the problem and solves it once or several times, each about the posture of the
last shift.
"""

from __future__ import annotations

from collections.abc import Sequence
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

ZERO_SHIFT = 1e-5  # [m] smaller shifts are zero
DIFFERENCE_STEP = 1e-3  # [m] of difference quotients of the weight's moment
_FORCE_WEIGHT = 1e-6  # [m^2] weight of the squared forces, in units of the load
_TORQUE_MARGIN = 0.02  # of the torque limits, as Jacobians change with the shift
_SOLVED = ("Solved", "AlmostSolved")
_NUM_LEADING_COLUMNS = 3  # columns of the program before those of forces


@dataclass(frozen=True)
class BalanceSolution:
    """A shift and its forces."""

    shift: Array  # (2,) [m]
    force: Array  # (P, 3 n) in units of the load
    excess: float  # of the torque limits


@dataclass(frozen=True)
class LiftPosture:
    """The limbs with a shifted body, in P phases of the lift."""

    shift: Array  # (2,) [m]
    jacobian: Array  # (n, 3, J) of points that are pushed, world
    reached: bool  # whether standing limbs reach
    moment: Array  # (P, 3) of the weight about the body's origin, by units of the load
    slope: Array  # (P, 2, 3) of it, by the shift
    links: Array  # (L, J) torque / limit over S_tau of the links' own weight, of standing limbs
    inward: Array  # (L, n, 3) how deep toes are commanded into surfaces, by units of the load [m]


class LiftBalance:
    """The program of one instant with lifted limbs, in P phases of the lift."""

    def __init__(
        self, scene: MotionScene, phases: list[Instants], k: int, cone_scale: float
    ) -> None:
        self.scene, self.phases, self.k, self.cone_scale = scene, phases, k, cone_scale
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
        self.size = size = _NUM_LEADING_COLUMNS + 3 * n
        self.load = load / unit
        self.equal = np.zeros((6, size))
        normal = by_point(robot, lifts.normal[k], 0)[stands]
        self.touching = pushed_points(robot, lifts.toes[k], lifts.normal[k])
        self.equal[:, _NUM_LEADING_COLUMNS:] = grasp_matrix(self.touching[stands] - lifts.com[k])
        self.equal[3:, 0] = np.cross([1.0, 0.0, 0.0], self.load[:3])
        self.equal[3:, 1] = np.cross([0.0, 1.0, 0.0], self.load[:3])
        frame = contact_frame(normal).axes  # (n, 3, 3)
        self.steep = (
            cone_scale * by_point(robot, lifts.mu[k], 0)[stands] / spec.force.safety_friction
        )
        self.press = np.zeros((n, size))
        self.cones = np.zeros((n, 3, size))
        for i in range(n):
            force_columns = slice(_NUM_LEADING_COLUMNS + 3 * i, _NUM_LEADING_COLUMNS + 3 * i + 3)
            self.press[i, force_columns] = -frame[i, 0]
            self.cones[i, :, force_columns] = -frame[i]
            self.cones[i, 0, force_columns] *= self.steep[i]

    def with_sole_margin(self, margin_fraction: float) -> LiftBalance:
        """Return the program with a fraction of the soles' margin; itself without flat feet."""
        margin = margin_fraction * self.scene.spec.margins.sole
        if self.scene.robot.sole is None or margin == 0:
            return self
        scene = replace(self.scene, robot=self.scene.robot.pressed_within(margin))
        return LiftBalance(scene, self.phases, self.k, self.cone_scale)

    def with_depth(self, depth: float) -> LiftBalance:
        """Return the program with a required depth of commands in their surfaces [m]."""
        result = copy(self)
        result.depth = depth
        return result

    def compute_posture(self, shift: Array) -> LiftPosture:
        """Compute the limbs with the body shifted by (2,) [m].

        Jacobians of a limb out of reach are zero, so that its torques are free: another shift may
        bring it into reach.
        """
        robot, k = self.scene.robot, self.k
        offsets = np.array([*shift, 0.0]) + DIFFERENCE_STEP * np.array(
            [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        )
        if robot.links is None:
            offsets = offsets[:1]
        count = len(self.phases), len(offsets)
        com = np.broadcast_to(self.lifts.com[k] + offsets, (*count, 3))
        rpy = np.broadcast_to(self.lifts.rpy[k], (*count, 3))
        toes, normal = (
            np.stack([np.broadcast_to(vars(phase)[name][k], (len(offsets), *phase.toes[k].shape))
                      for phase in self.phases])
            for name in ("toes", "normal")
        )  # fmt: skip
        angles = standing_inverse(robot, com, rpy, toes, normal).best()
        first = angles[:1, 0]
        is_unreached = np.asarray(np.isnan(first).any(axis=-1))
        jacobian = point_jacobian(robot, rpy[0, :1], np.nan_to_num(first), normal[0, :1])
        jacobian[by_point(robot, is_unreached, 1)] = 0.0
        standing = by_point(robot, self.lifts.contact[k], 0)
        inward = np.zeros((len(self.stands), self.n, 3))
        if self.depth > 0:
            pose = rpy[0, :1], np.nan_to_num(first), normal[0, :1]
            arms = self.touching - self.lifts.com[k] - offsets[0]
            compensates_sag = self.scene.spec.force.deflection_compensation == "compensated"
            bending = joint_bending(robot, jacobian, arms[None], standing[None], compensates_sag)
            of_toes = contact_jacobian(robot, *pose)
            depths = self.unit * commanded_depth(of_toes, normal[0, :1], bending)[0]
            inward = depths[self.stands][:, standing]
        moment, slope = np.zeros((count[0], 3)), np.zeros((count[0], 2, 3))
        links = np.zeros((len(self.stands), robot.joint_count))
        if robot.links is not None:
            angles_reached = self._replace_unreached(angles)
            gravity_torque = link_torques(robot, rpy[0, 0], angles_reached[0, 0])[self.stands]
            links = (
                gravity_torque * self.scene.spec.force.safety_torque / robot.max_torque[self.stands]
            )
            by_shift = weight_moment(robot, rpy, angles_reached) / self.unit
            moment = by_shift[:, 0]
            slope = (by_shift[:, 1:] - by_shift[:, :1]) / DIFFERENCE_STEP
        reached = not bool(is_unreached[0][self.stands].any())
        return LiftPosture(
            np.asarray(shift), jacobian[0][standing], reached, moment, slope, links, inward
        )

    def _replace_unreached(self, angles: Array) -> Array:
        """Replace angles (P, 3, N, J) of limbs out of reach by those of the standing robot."""
        chain = self.scene.robot.mechanism
        assert isinstance(chain, SerialChain)
        reference = angles[:, :1]
        is_unreached = np.isnan(reference).any(axis=-1, keepdims=True)
        reference = np.where(is_unreached, chain.posture, reference)
        return np.where(
            is_unreached | np.isnan(angles).any(axis=-1, keepdims=True), reference, angles
        )

    def _compute_torque_use(self, jacobian: Array) -> Array:
        """Compute torque use (n, 3, J), by the limits over S_tau, per unit of the load."""
        limit = self.scene.robot.max_torque[self.stands][self.limb_of, None]
        torque_use: Array = jacobian * self.unit * self.scene.spec.force.safety_torque / limit
        return torque_use

    def compute_excess(self, compute_posture: LiftPosture, force: Array) -> float:
        """Compute the excess of forces (P, 3 n) over the torque limits; infinite out of reach."""
        forces = force.reshape(len(force), -1, 3)
        torque_use = np.einsum(
            "nij,pni->pnj", self._compute_torque_use(compute_posture.jacobian), forces
        )
        if self.points > 1:
            torque_use = torque_use.reshape(len(force), len(self.stands), self.points, -1).sum(
                axis=2
            )
        max_use = float(np.abs(torque_use + compute_posture.links).max())
        return max_use - 1.0 if compute_posture.reached else np.inf

    def _repeat_by_phase(self, rows: Array) -> Array:
        """Repeat rows (R, 3 + 3 n) for phases with a common shift: (P R, 3 + 3 n P)."""
        count, num_force_columns = len(self.phases), 3 * self.n
        repeated = np.zeros((count, len(rows), _NUM_LEADING_COLUMNS + count * num_force_columns))
        repeated[:, :, :_NUM_LEADING_COLUMNS] = rows[:, :_NUM_LEADING_COLUMNS]
        for phase in range(count):
            repeated[
                phase,
                :,
                _NUM_LEADING_COLUMNS + phase * num_force_columns : _NUM_LEADING_COLUMNS
                + (phase + 1) * num_force_columns,
            ] = rows[:, _NUM_LEADING_COLUMNS:]
        return repeated.reshape(count * len(rows), repeated.shape[-1])

    def _build_torque_rows(self, jacobian: Array) -> Array:
        """Build the rows (2 L J, 3 + 3 n) of torques in both directions, less their excess."""
        torque_use = self._compute_torque_use(jacobian)
        rows = np.zeros((len(self.stands), 2, self.scene.robot.joint_count, self.size))
        for i, limb in enumerate(self.limb_of):
            force_columns = slice(_NUM_LEADING_COLUMNS + 3 * i, _NUM_LEADING_COLUMNS + 3 * i + 3)
            rows[limb, 0][:, force_columns] = torque_use[i].T
            rows[limb, 1][:, force_columns] = -torque_use[i].T
        rows[..., 2] = -1.0
        return rows.reshape(-1, self.size)

    def _build_depth_rows(self, posture: LiftPosture) -> Array:
        """Build the rows (L, 3 + 3 n) of depths, relative to the required one; none without it."""
        limbs = len(self.stands) if self.depth > 0 else 0
        rows = np.zeros((limbs, self.size))
        if limbs:
            rows[:, _NUM_LEADING_COLUMNS:] = -posture.inward.reshape(limbs, -1) / self.depth
        return rows

    def _compute_force_margins(self, fraction: float) -> tuple[float, Array]:
        """Compute least normal force and offsets (n,) of friction cones, per unit of the load."""
        spec = self.scene.spec
        weight = self.scene.robot.weight / self.unit / self.points
        required = spec.force.min_normal_force / self.unit / self.points
        min_force = max(fraction * spec.margins.normal_force * weight, required)
        return min_force, -self.steep * fraction * spec.margins.friction * weight

    def solve(
        self,
        posture: LiftPosture,
        margin_fraction: float,
        center: Array,
        trust: float,
        max_shift: float,
        price: float,
    ) -> BalanceSolution | None:
        """Solve for the smallest shift; None without a solution.

        Args:
            posture: Limbs about which the program is linearised.
            margin_fraction: Fraction of the margins.
            center: (2,) center of the trust region [m].
            trust: Its radius [m].
            max_shift: Largest shift [m].
            price: Cost of torques beyond the limits; 0 allows none.
        """
        size, n, phases = self.size, self.n, len(self.phases)
        depth_rows = self._build_depth_rows(posture)
        equal = self._repeat_by_phase(self.equal)
        equal.reshape(phases, 6, -1)[:, 3:, :2] += np.swapaxes(posture.slope, 1, 2)
        load = np.tile(self.load, (phases, 1))
        load[:, 3:] += posture.moment - posture.shift @ posture.slope
        num_columns = equal.shape[1]
        excess_row = np.zeros((1, num_columns))
        excess_row[0, 2] = -1.0 if price else 0.0
        no_excess_row = np.zeros((1, num_columns))
        no_excess_row[0, 2] = 0.0 if price else 1.0
        shift_balls = np.zeros((2, 3, num_columns))
        shift_balls[:, 1, 0] = shift_balls[:, 2, 1] = -1.0
        A = sparse.csc_matrix(
            np.vstack(
                [equal, no_excess_row, self._repeat_by_phase(self.press),
                 self._repeat_by_phase(self._build_torque_rows(posture.jacobian)),
                 self._repeat_by_phase(depth_rows), excess_row,
                 self._repeat_by_phase(self.cones.reshape(3 * n, size)),
                 shift_balls.reshape(6, num_columns)]
            )
        )  # fmt: skip
        torque_slack = np.stack([-posture.links, posture.links], axis=1) + (1.0 - _TORQUE_MARGIN)
        torques = np.tile(torque_slack.ravel(), phases)
        kinds = [
            clarabel.ZeroConeT(6 * phases + 1),
            clarabel.NonnegativeConeT(n * phases + len(torques) + len(depth_rows) * phases + 1),
            *[clarabel.SecondOrderConeT(3)] * (n * phases + 2),
        ]
        min_force, cone_offset = self._compute_force_margins(margin_fraction)
        cone_offsets = np.zeros((phases, n, 3))
        cone_offsets[..., 0] = cone_offset
        b = np.concatenate(
            [-load.ravel(), [0.0], np.full(n * phases, -min_force), torques,
             np.full(len(depth_rows) * phases, -1.0),
             [0.0], cone_offsets.ravel(), [max_shift, 0.0, 0.0], [trust + ZERO_SHIFT, *-center]]
        )  # fmt: skip
        x = _minimise_shift(A, b, kinds, price)
        if x is None:
            return None
        return BalanceSolution(x[:2], x[_NUM_LEADING_COLUMNS:].reshape(phases, -1), float(x[2]))


def _minimise_shift(
    A: sparse.csc_matrix, b: Array, kinds: Sequence[object], price: float
) -> Array | None:
    """Minimise squared shift and forces, and the price of excess; None without a solution."""
    num_columns = A.shape[1]
    squares = [2.0, 2.0, 0.0, *[2 * _FORCE_WEIGHT] * (num_columns - _NUM_LEADING_COLUMNS)]
    q = np.zeros(num_columns)
    q[2] = price
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    P = sparse.diags(squares, format="csc")
    solution = clarabel.DefaultSolver(P, q, A, b, kinds, settings).solve()
    return np.array(solution.x) if str(solution.status) in _SOLVED else None
