"""The program with all integers given, linearised: states eliminated, a small dense QP left.

Unknowns are the forces of standing legs and the footholds that are still free. Friction cones are
inscribed pyramids, so that what the QP holds the cone holds too. What a gait alone decides is made
once; the numbers of a linearisation are written by compiled code into arrays that serve again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import daqp
import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.kernels.contact_phases import compute_walk_cost
from climbplan.walking.kernels.discrete_rollout import roll_out_knots
from climbplan.walking.kernels.parameters import (
    AffineStates,
    FootholdUnknowns,
    GaitHorizon,
    LinearisationPoint,
    QpBuffers,
    QpLayout,
    QpObjective,
    QpProblem,
    RowBlock,
    ToePlacement,
)
from climbplan.walking.kernels.qp_assembly import assemble_qp, split_unknowns, write_force_cost
from climbplan.walking.kernels.swept_terrain import compute_swing_heights
from climbplan.walking.kernels.toe_workspace import compute_reach_violation, place_toes
from climbplan.walking.offline.footing import UNKNOWN, Footing, build_footing, compute_toe_heights
from climbplan.walking.offline.joint_rows import JointRows
from climbplan.walking.task.task import ANGLES, POSITION, STATE, Gait, WalkTask

FACETS = 8
FOOT_SCALE = 0.1  # [m] unit of the foothold unknowns
_RIDGE = 1e-7  # curvature along directions that cost nothing
_SOLVED = 1
_SOLVED_SOFTLY = 2
_UNSOLVED = 0
_NOT_CONVEX = -5
_AT_UPPER, _AT_LOWER = 1, 3  # rows that DAQP starts with
_SOFT_ROW = 8  # rows that DAQP may break at a price
_INFINITY = 1e30
_SPEED_EXCESS_LENGTH = 0.1  # [m] of overreach that joints twice as fast as they can be are worth
_MAX_ITERATIONS = 2000  # DAQP iterations: infeasible QPs end far sooner


@dataclass(frozen=True)
class Iterate:
    """A point to linearise about."""

    state: Array  # (N + 1, 12)
    force: Array  # (N, L, 3) zeros of swinging legs
    spots: Array  # (F, 2) free footholds [m]


@dataclass(frozen=True)
class PinnedQp:
    """min 1/2 z'Hz + g'z with bounds and rows; states are offset + sensitivity z.

    Its arrays are the program's, which the next linearisation overwrites.
    """

    hessian: Array
    gradient: Array
    lower: Array  # variables, then rows
    upper: Array
    rows: Array
    offset: Array  # (N + 1, 12)
    sensitivity: Array  # (N + 1, 12, Z)


class PinnedProgram:
    """One gait of one task. `margin`: kept inside the boxes by toes yet to be placed [m]."""

    def __init__(self, task: WalkTask, gait: Gait, margin: float = 0.0) -> None:
        self.task, self.gait, self.margin = task, gait, margin
        self.start, self.steps = task.start, task.steps
        self.footing: Footing = build_footing(gait)
        self.height = compute_toe_heights(
            task.ground, gait, task.swing_clearance
        )  # of swinging toes: at least
        ground, region = task.ground, self.footing.region
        self.tilt = ground.slope[region]  # (F, 2) rise of footholds
        self._sloped = bool(ground.slope.any())
        self.base = ground.height[region] - (self.tilt * ground.inner[region]).sum(axis=1)
        contact = gait.contact[:-1]
        self.stand_knot, self.stand_leg = np.nonzero(contact)
        self.num_forces = len(self.stand_knot)
        self.foot_column = 3 * self.num_forces
        self.num_unknowns = self.foot_column + 2 * self.footing.count
        self.num_fixed_rows = self.num_forces * FACETS + self.footing.count * ground.corners.shape[1]
        self.force_scale = task.weight / task.body.leg_count
        self._next_state = np.empty((task.knots, STATE))
        self._derivatives = np.empty((task.knots, STATE + 6 * task.body.leg_count, STATE))
        self._columns = 3 * np.concatenate([[0], np.cumsum(contact.sum(axis=1))])  # by knot
        weights, reference = task.weights, task.reference
        self._weight = np.concatenate([[weights.height], weights.velocity, weights.angles])
        self._reference = np.concatenate(
            [reference.height[:, None], reference.velocity, reference.euler], axis=1
        )
        self.joints = JointRows(task, gait, self.footing)
        self._force_hessian = self._build_force_hessian()
        self._qp = self._allocate_qp()
        self._scale: Array | None = None  # units of unknowns where rounding asks for them
        self._multipliers: Array | None = None  # multipliers of the QP before: where to start
        self.num_iterations = 0  # DAQP iterations of the last step
        self.is_elastic = False  # its answer leaves the workspace where nothing else was possible

    def restart(self, task: WalkTask) -> None:
        """The same gait from another start; a first guess of what will be active is kept."""
        self.start, self.steps = task.start, task.steps
        self.joints.set_task(task)
        if task.ground.is_rough:  # raised for the one before
            self.height = compute_toe_heights(task.ground, self.gait, task.swing_clearance)
        reference = task.reference
        self._reference[:, 0] = reference.height

    @property
    def horizon(self) -> GaitHorizon:
        """The gait's horizon as compiled functions take it."""
        task = self.task
        use_mean = task.integrator == "mean"
        return GaitHorizon(
            self.steps, use_mean, self.gait.contact, self.start.state, task.workspace_over_stance
        )

    @property
    def placement(self) -> ToePlacement:
        """What decides where toes are, as compiled functions take it."""
        return ToePlacement(
            self.task.body.toe_workspace,
            self.footing.foothold,
            self.height,
            self.start.toes,
            self.base,
            self.tilt,
        )

    def split_solution(self, z: Array) -> tuple[Array, Array]:
        """Forces (N, L, 3) [N] and free footholds (F, 2) [m] of the unknowns."""
        force, spots = split_unknowns(
            np.ascontiguousarray(z), self.gait.contact, self.force_scale, FOOT_SCALE
        )
        return force, spots

    def compute_toes(self, state: Array, spots: Array) -> Array:
        """All toes (N + 1, L, 3)."""
        self.find_heights(state)
        toes: Array = place_toes(self.placement, state, spots)
        return toes

    def find_heights(self, state: Array) -> None:
        """Heights that are not known yet: of the ground under the middles of toes' boxes."""
        if not self._sloped:
            return
        is_unknown = self.height == UNKNOWN
        if not is_unknown.any():
            return
        body, ground = self.task.body, self.task.ground
        centers = np.stack(
            [x[POSITION] + body.toe_center @ rotation_world_body(x[ANGLES]).T for x in state]
        )[..., :2]
        level = ground.compute_height(ground.nearest(centers), centers)
        self.height = np.where(is_unknown, level, self.height)

    def raise_swing_heights(self, toes: Array) -> bool:
        """Lift swinging toes (N + 1, L, 3) above what is beneath their ways; False if they are.

        Heights only grow, so that linearisations come to an end.
        """
        task, ground = self.task, self.task.ground
        if not ground.is_rough:
            return False
        gait = self.gait
        clear = compute_swing_heights(toes, gait.contact, gait.region, ground.region_arrays)
        required = np.where(gait.contact, self.height, clear + task.swing_clearance)
        is_higher = bool((required > self.height + 1e-9).any())
        self.height = np.maximum(self.height, required)
        return is_higher

    def roll_out(self, toes: Array, force: Array) -> Array:
        """States (N + 1, 12) that forces (N, L, 3) at toes (N + 1, L, 3) bring about."""
        task, body = self.task, self.task.body
        states: Array = roll_out_knots(
            body.parameters,
            self.steps,
            task.integrator == "mean",
            self.start.state,
            toes,
            force,
        )
        return states

    def compute_violation(self, state: Array, toes: Array) -> float:
        """How far toes leave their boxes at knots 1 to N, and standing ones at 0 [m].

        Or the body misses its goal, or joints are too fast, if that is more.
        """
        body, over_stance = self.task.body, self.task.workspace_over_stance
        contact = self.gait.contact
        violation = float(compute_reach_violation(body.toe_workspace, over_stance, contact, state, toes))
        violation = max(violation, float(self.task.goal.compute_violation(state[-1, :2])))
        spots = toes[self.footing.first, self.footing.leg, :2]
        return max(violation, _SPEED_EXCESS_LENGTH * self.joints.compute_speed_excess(state, toes, spots, self.tilt))

    def compute_cost(self, state: Array, force: Array) -> float:
        """The objective, eq. (8.30), of states (N + 1, 12) and forces (>= N, L, 3)."""
        weights = self.task.weights
        difference = weights.force_difference
        return float(
            compute_walk_cost(state, force, self._reference, self._weight, weights.motion, difference)
        )

    def build_qp(self, iterate: Iterate) -> PinnedQp:
        """The QP of the linearisation about an iterate."""
        task, qp = self.task, self._qp
        weights, foothold = task.weights, self.footing.foothold
        toes = self.compute_toes(iterate.state, iterate.spots)
        if self.raise_swing_heights(toes):
            toes = self.compute_toes(iterate.state, iterate.spots)
        first_row = self.num_fixed_rows
        rows = qp.rows[first_row:]
        low, high = qp.lower[self.num_unknowns + first_row :], qp.upper[self.num_unknowns + first_row :]
        problem = QpProblem(
            body=task.body.parameters,
            horizon=self.horizon,
            placement=self.placement,
            objective=QpObjective(
                self._reference, self._weight, weights.motion, self._force_hessian, _RIDGE
            ),
            layout=QpLayout(
                self._columns, self.force_scale, FOOT_SCALE, self.foot_column, self.margin
            ),
        )
        point = LinearisationPoint(iterate.state, iterate.force, iterate.spots)
        states = AffineStates(qp.offset, qp.sensitivity)
        block = RowBlock(rows, low, high)
        buffers = QpBuffers(self._next_state, self._derivatives, states, qp.hessian, qp.gradient, block)
        count = assemble_qp(problem, point, toes, buffers)
        if task.goal.is_set:  # of the centre of mass at the last knot
            rows[count:] = qp.sensitivity[-1, :2]
            low[count:] = task.goal.lower - qp.offset[-1, :2]
            high[count:] = task.goal.upper - qp.offset[-1, :2]
        joint_rows = slice(self.first_joint_row, None)
        joint_limits = slice(self.num_unknowns + self.first_joint_row, None)
        footholds = FootholdUnknowns(foothold, iterate.spots, self.tilt, FOOT_SCALE, self.foot_column)
        num_joint_rows = self.joints.write_rows(
            self.joints.build_motion(iterate.state, toes),
            footholds,
            states,
            self.force_scale,
            RowBlock(qp.rows[joint_rows], qp.lower[joint_limits], qp.upper[joint_limits]),
        )
        num_rows = self.first_joint_row + num_joint_rows
        if num_rows == len(qp.rows):
            return qp
        return replace(
            qp, rows=qp.rows[:num_rows], lower=qp.lower[: self.num_unknowns + num_rows],
            upper=qp.upper[: self.num_unknowns + num_rows],
        )  # fmt: skip

    def solve_qp(
        self,
        iterate: Iterate,
        elastic: bool = False,
        soft: bool = False,
        max_iterations: int = _MAX_ITERATIONS,
        any_speed: bool = False,
    ) -> Iterate | None:
        """The optimum of that QP; None if it has none.

        elastic: if it has none, the one with the least overreach, dearly paid for; soft: look for
        that at once; any_speed: if it has none, the one for motors of any speed. most: DAQP
        iterations, with any_speed twice. `spent` and `softly` tell how it went.
        """
        self.num_iterations, self.is_elastic = 0, False
        qp = self.build_qp(iterate)
        if (qp.lower > qp.upper).any():
            return None
        if self.num_unknowns == 0:  # no leg ever stands
            return self.build_iterate(qp, np.zeros(0))
        flag = 0
        if not soft:
            z, flag = self._minimise(qp, self._multipliers, max_iterations)
            if flag != _SOLVED and self._multipliers is not None:
                z, flag = self._minimise(qp, None, max_iterations - self.num_iterations)
        if flag != _SOLVED and any_speed and self.joints.max_rows:
            num_rows, max_iterations = self.first_joint_row + self.joints.num_torque_rows, max_iterations + self.num_iterations
            qp = replace(
                qp, rows=qp.rows[:num_rows], lower=qp.lower[: self.num_unknowns + num_rows],
                upper=qp.upper[: self.num_unknowns + num_rows],
            )  # fmt: skip
            z, flag = self._minimise(qp, None, max_iterations - self.num_iterations)
        if flag != _SOLVED and (elastic or soft) and self.num_iterations < max_iterations:
            z, flag = self._minimise(qp, None, max_iterations - self.num_iterations, _SOFT_ROW)
            self.is_elastic = flag == _SOLVED
        if flag != _SOLVED:
            return None
        return self.build_iterate(qp, z)

    def _minimise(
        self, qp: PinnedQp, multipliers: Array | None, max_iterations: int, workspace_sense: int = 0
    ) -> tuple[Array, int]:
        """DAQP's answer and flag, from an active set if multipliers are given.

        reach: how DAQP is to take the rows of the workspace.
        """
        sense = np.zeros(len(qp.lower), np.int32)
        if workspace_sense:
            sense[self.num_unknowns + self.num_fixed_rows : self.num_unknowns + self.first_joint_row] = workspace_sense
        if multipliers is not None:
            # Which speeds have rows differs from one linearisation to the next
            last_multipliers = multipliers[: self.num_unknowns + self.first_joint_row + self.joints.num_torque_rows]
            sense[: len(last_multipliers)][last_multipliers > 0] = _AT_UPPER
            sense[: len(last_multipliers)][last_multipliers < 0] = _AT_LOWER
        z, flag, info = _solve_daqp(qp, self._scale, sense, max_iterations)
        if flag == _NOT_CONVEX and self._scale is None:
            # Over long horizons early forces weigh a million times what footholds do: in units of
            # their own curvature rounding leaves the Hessian what it is.
            self._scale = 1.0 / np.sqrt(np.diag(qp.hessian))
            z, flag, info = _solve_daqp(qp, self._scale, sense, max_iterations)
        self.num_iterations += int(info["iterations"])
        # Of QPs whose soft rows contradict others DAQP may say that it solved them, without numbers
        is_solved = flag in (_SOLVED, _SOLVED_SOFTLY) and bool(np.isfinite(z).all())
        self._multipliers = info["lam"] if is_solved and flag == _SOLVED and workspace_sense == 0 else None
        return z, _SOLVED if is_solved else min(flag, _UNSOLVED)

    def build_iterate(self, qp: PinnedQp, z: Array) -> Iterate:
        """The point that unknowns stand for, its states as the QP predicts them."""
        force, spots = self.split_solution(z)
        return Iterate(qp.offset + qp.sensitivity @ z, force, spots)

    def _allocate_qp(self) -> PinnedQp:
        """Arrays of the QP with what no linearisation changes: friction and bounds."""
        knots, contact = self.task.knots, self.gait.contact
        num_standing, num_lifted = contact[1:].sum(), (~contact[1:]).sum()
        num_leaving = (contact[:-1] & ~contact[1:]).sum() if self.task.workspace_over_stance else 0
        num_friction_rows = self.num_forces * FACETS
        num_goal_rows = 2 * int(self.task.goal.is_set)
        num_moving_rows = 3 * int(num_standing + num_leaving) + 2 * int(num_lifted) + num_goal_rows
        self.first_joint_row = self.num_fixed_rows + num_moving_rows  # first row of joints
        rows = np.zeros((self.first_joint_row + self.joints.max_rows, self.num_unknowns))
        # Friction, eq. (8.18), as a pyramid inside the cone about each region's normal
        force_index = np.arange(self.num_forces)
        blocks = rows[:num_friction_rows, : self.foot_column].reshape(self.num_forces, FACETS, self.num_forces, 3)
        region_of_force = self.gait.region[self.stand_knot, self.stand_leg]
        blocks[force_index, :, force_index] = _build_facets(self.task.ground.friction) @ self.task.ground.frame[region_of_force]
        # Force limits, eq. (8.23), and regions, eq. (8.24)
        max_force = self.task.body.force_limit / self.force_scale
        ground, region = self.task.ground, self.footing.region
        lower, upper = np.empty(self.num_unknowns + len(rows)), np.empty(self.num_unknowns + len(rows))
        lower[: self.foot_column] = np.tile([-max_force, -max_force, 0.0], self.num_forces)
        upper[: self.foot_column] = max_force
        region_lower, region_upper, region_sides = ground.footholds
        lower[self.foot_column : self.num_unknowns] = (region_lower[region] / FOOT_SCALE).ravel()
        upper[self.foot_column : self.num_unknowns] = (region_upper[region] / FOOT_SCALE).ravel()
        lower[self.num_unknowns :], upper[self.num_unknowns :] = -_INFINITY, 0.0
        joint_rows = slice(self.num_unknowns + self.first_joint_row, None)
        self.joints.bound_torques(lower[joint_rows], upper[joint_rows])
        sides = ground.corners.shape[1]
        for k in range(self.footing.count if sides else 0):
            first, column = num_friction_rows + k * sides, self.foot_column + 2 * k
            rows[first : first + sides, column : column + 2] = region_sides[region[k], :, :2]
            side_rows = slice(self.num_unknowns + first, self.num_unknowns + first + sides)
            upper[side_rows] = region_sides[region[k], :, 2] / FOOT_SCALE
        return PinnedQp(
            np.zeros((self.num_unknowns, self.num_unknowns)),
            np.zeros(self.num_unknowns),
            lower,
            upper,
            rows,
            np.zeros((knots + 1, STATE)),
            np.zeros((knots + 1, STATE, self.num_unknowns)),
        )

    def _build_force_hessian(self) -> Array:
        """Sum over ordered pairs of || f_s - f_t ||^2 = 2 (L sum f^2 - (sum f)^2) at each knot."""
        hessian = np.zeros((self.num_unknowns, self.num_unknowns))
        factor = 4.0 * self.task.weights.force_difference * self.force_scale**2
        write_force_cost(self.stand_knot, self.task.body.leg_count, factor, hessian)
        return hessian


@cache
def _build_facets(friction: float) -> Array:
    """(FACETS, 3) rows of a pyramid inside a friction cone about z."""
    angle = 2 * np.pi * (np.arange(FACETS) + 0.5) / FACETS
    slope = friction * np.cos(np.pi / FACETS)
    return np.column_stack([np.cos(angle), np.sin(angle), np.full(FACETS, -slope)])


def _solve_daqp(
    qp: PinnedQp, unit: Array | None, sense: NDArray[np.int32], max_iterations: int
) -> tuple[Array, int, Mapping[str, Any]]:
    """DAQP's answer, flag and facts; unit (Z,): of unknowns, 1 if None."""
    rows, hessian, gradient, upper, lower = qp.rows, qp.hessian, qp.gradient, qp.upper, qp.lower
    if unit is not None:
        rows, hessian, gradient = rows * unit, hessian * np.outer(unit, unit), gradient * unit
        upper, lower = upper.copy(), lower.copy()
        upper[: len(unit)] /= unit
        lower[: len(unit)] /= unit
    z, _, flag, info = daqp.solve(
        hessian,
        gradient,
        rows,
        upper,
        lower,
        sense,
        primal_tol=1e-8,
        iter_limit=max(max_iterations, 1),
        eps_prox=0.0,
    )
    if unit is not None and np.isfinite(z).all():
        z = z * unit
    return z, int(flag), info
