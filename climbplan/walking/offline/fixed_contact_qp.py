"""The program with all integers fixed, linearised: a small dense QP without states.

    minimise    1/2 z' H z + g' z
    subject to  friction pyramids, force limits, regions, workspace boxes, goal, joint limits

Unknowns z are the forces of standing legs and the free footholds; states are eliminated
(condensing, Bock and Plitt 1984). The pyramids are inscribed in the cones. What a gait alone
decides is computed once; compiled code writes the numbers of each linearisation into reused arrays.
Equation numbers are those of X. Lin (UCLA 2022).
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
    QpRows,
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
RIDGE = 1e-7  # curvature along directions that cost nothing
_SOLVED = 1
_SOLVED_SOFTLY = 2
_UNSOLVED = 0
_NOT_CONVEX = -5
_AT_UPPER, _AT_LOWER = 1, 3  # rows that DAQP starts with
_SOFT_ROW = 8  # flag of rows that DAQP may violate at a price
_INFINITY = 1e30
_SPEED_EXCESS_LENGTH = 0.1  # [m] of workspace violation that equal a joint at twice its limit
_MAX_ITERATIONS = 2000  # of DAQP; infeasible QPs end earlier


@dataclass(frozen=True)
class WalkIterate:
    """A point of linearisation."""

    state: Array  # (N + 1, 12)
    force: Array  # (N, L, 3) zeros of swinging legs
    spots: Array  # (F, 2) free footholds [m]


@dataclass(frozen=True)
class FixedContactQp:
    """A QP: min 1/2 z'Hz + g'z with bounds and rows; states are offset + sensitivity z.

    Its arrays are those of the program, which the next linearisation overwrites.
    """

    hessian: Array
    gradient: Array
    lower: Array  # variables, then rows
    upper: Array
    rows: Array
    offset: Array  # (N + 1, 12)
    sensitivity: Array  # (N + 1, 12, Z)


class FixedContactProgram:
    """The program of one gait of a task."""

    def __init__(self, task: WalkTask, gait: Gait, margin: float = 0.0) -> None:
        """Allocate the arrays of a gait.

        Args:
            task: The task.
            gait: The gait.
            margin: Distance that toes yet to be placed keep from the faces of their boxes [m].
        """
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
        self.num_fixed_rows = (
            self.num_forces * FACETS + self.footing.count * ground.corners.shape[1]
        )
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
        """Replace the start of the task; the gait and the warm start of the QP are kept."""
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
        """Placement of the toes, as compiled functions take it."""
        return ToePlacement(
            self.task.body.toe_workspace,
            self.footing.foothold,
            self.height,
            self.start.toes,
            self.base,
            self.tilt,
        )

    def split_solution(self, z: Array) -> tuple[Array, Array]:
        """Return forces (N, L, 3) [N] and free footholds (F, 2) [m] of the unknowns."""
        force, spots = split_unknowns(
            np.ascontiguousarray(z), self.gait.contact, self.force_scale, FOOT_SCALE
        )
        return force, spots

    def compute_toes(self, state: Array, spots: Array) -> Array:
        """Return all toes (N + 1, L, 3) at states (N + 1, 12) and free footholds (F, 2)."""
        self.find_heights(state)
        toes: Array = place_toes(self.placement, state, spots)
        return toes

    def find_heights(self, state: Array) -> None:
        """Find unknown heights of swinging toes: the ground under the middles of their boxes."""
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
        """Raise swinging toes (N + 1, L, 3) above the terrain under them; return whether any rose.

        Heights only grow, so that repeated linearisations end.
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
        """Return the states (N + 1, 12) under forces (N, L, 3) at toes (N + 1, L, 3)."""
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
        """Return the largest workspace violation [m].

        Toes count at knots 1 to N, standing ones at knot 0, too. A missed goal and too fast joints
        count if they are worse.
        """
        body, over_stance = self.task.body, self.task.workspace_over_stance
        contact = self.gait.contact
        violation = float(
            compute_reach_violation(body.toe_workspace, over_stance, contact, state, toes)
        )
        violation = max(violation, float(self.task.goal.compute_violation(state[-1, :2])))
        spots = toes[self.footing.first, self.footing.leg, :2]
        return max(
            violation,
            _SPEED_EXCESS_LENGTH * self.joints.compute_speed_excess(state, toes, spots, self.tilt),
        )

    def compute_cost(self, state: Array, force: Array) -> float:
        """Return the objective, eq. (8.30), at states (N + 1, 12) and forces (>= N, L, 3)."""
        weights = self.task.weights
        difference = weights.force_difference
        return float(
            compute_walk_cost(
                state, force, self._reference, self._weight, weights.motion, difference
            )
        )

    def build_qp(self, iterate: WalkIterate) -> FixedContactQp:
        """Return the QP of the linearisation about an iterate."""
        task, qp = self.task, self._qp
        weights, foothold = task.weights, self.footing.foothold
        toes = self.compute_toes(iterate.state, iterate.spots)
        if self.raise_swing_heights(toes):
            toes = self.compute_toes(iterate.state, iterate.spots)
        first_row = self.num_fixed_rows
        rows = qp.rows[first_row:]
        low, high = (
            qp.lower[self.num_unknowns + first_row :],
            qp.upper[self.num_unknowns + first_row :],
        )
        problem = QpProblem(
            body=task.body.parameters,
            horizon=self.horizon,
            placement=self.placement,
            objective=QpObjective(
                self._reference, self._weight, weights.motion, self._force_hessian, RIDGE
            ),
            layout=QpLayout(
                self._columns, self.force_scale, FOOT_SCALE, self.foot_column, self.margin
            ),
        )
        point = LinearisationPoint(iterate.state, iterate.force, iterate.spots)
        states = AffineStates(qp.offset, qp.sensitivity)
        block = QpRows(rows, low, high)
        buffers = QpBuffers(
            self._next_state, self._derivatives, states, qp.hessian, qp.gradient, block
        )
        count = assemble_qp(problem, point, toes, buffers)
        if task.goal.is_set:  # of the centre of mass at the last knot
            rows[count:] = qp.sensitivity[-1, :2]
            low[count:] = task.goal.lower - qp.offset[-1, :2]
            high[count:] = task.goal.upper - qp.offset[-1, :2]
        joint_rows = slice(self.first_joint_row, None)
        joint_limits = slice(self.num_unknowns + self.first_joint_row, None)
        footholds = FootholdUnknowns(
            foothold, iterate.spots, self.tilt, FOOT_SCALE, self.foot_column
        )
        num_joint_rows = self.joints.write_rows(
            self.joints.build_motion(iterate.state, toes),
            footholds,
            states,
            self.force_scale,
            QpRows(qp.rows[joint_rows], qp.lower[joint_limits], qp.upper[joint_limits]),
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
        iterate: WalkIterate,
        elastic: bool = False,
        soft: bool = False,
        max_iterations: int = _MAX_ITERATIONS,
        any_speed: bool = False,
    ) -> WalkIterate | None:
        """Solve the QP of the linearisation about an iterate.

        `num_iterations` and `is_elastic` describe the solution afterwards.

        Args:
            iterate: The point of linearisation.
            elastic: If the QP is infeasible, allow workspace violation at a high price.
            soft: Use this elastic mode at once.
            max_iterations: Limit on DAQP iterations; twice as many with `any_speed`.
            any_speed: If the QP is infeasible, drop the speed limits of motors.

        Returns:
            The next iterate; None if there is no solution.
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
            num_rows, max_iterations = (
                self.first_joint_row + self.joints.num_torque_rows,
                max_iterations + self.num_iterations,
            )
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
        self,
        qp: FixedContactQp,
        multipliers: Array | None,
        max_iterations: int,
        workspace_sense: int = 0,
    ) -> tuple[Array, int]:
        """Solve the QP by DAQP, from the active set of multipliers if these are given.

        Args:
            qp: The QP.
            multipliers: Multipliers of a similar QP; None: start without an active set.
            max_iterations: Limit on DAQP iterations.
            workspace_sense: Flag of the workspace rows, which makes them soft; 0: they are hard.

        Returns:
            The solution and its flag.
        """
        sense = np.zeros(len(qp.lower), np.int32)
        if workspace_sense:
            sense[
                self.num_unknowns + self.num_fixed_rows : self.num_unknowns + self.first_joint_row
            ] = workspace_sense
        if multipliers is not None:
            # Speed rows differ between linearisations, so that their multipliers are not reused
            last_multipliers = multipliers[
                : self.num_unknowns + self.first_joint_row + self.joints.num_torque_rows
            ]
            sense[: len(last_multipliers)][last_multipliers > 0] = _AT_UPPER
            sense[: len(last_multipliers)][last_multipliers < 0] = _AT_LOWER
        z, flag, info = _solve_daqp(qp, self._scale, sense, max_iterations)
        if flag == _NOT_CONVEX and self._scale is None:
            # Over long horizons the curvature by early forces is far larger than that by footholds.
            # Scaling by the diagonal keeps the Hessian positive definite under rounding.
            self._scale = 1.0 / np.sqrt(np.diag(qp.hessian))
            z, flag, info = _solve_daqp(qp, self._scale, sense, max_iterations)
        self.num_iterations += int(info["iterations"])
        # DAQP may report success with NaN if soft rows contradict others
        is_solved = flag in (_SOLVED, _SOLVED_SOFTLY) and bool(np.isfinite(z).all())
        self._multipliers = (
            info["lam"] if is_solved and flag == _SOLVED and workspace_sense == 0 else None
        )
        return z, _SOLVED if is_solved else min(flag, _UNSOLVED)

    def build_iterate(self, qp: FixedContactQp, z: Array) -> WalkIterate:
        """Return the iterate of a solution, with the states that the QP predicts."""
        force, spots = self.split_solution(z)
        return WalkIterate(qp.offset + qp.sensitivity @ z, force, spots)

    def _allocate_qp(self) -> FixedContactQp:
        """Return the arrays of the QP with what no linearisation changes: friction and bounds."""
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
        blocks = rows[:num_friction_rows, : self.foot_column].reshape(
            self.num_forces, FACETS, self.num_forces, 3
        )
        region_of_force = self.gait.region[self.stand_knot, self.stand_leg]
        ground, region = self.task.ground, self.footing.region
        facets = _build_facets(ground.friction)
        if ground.region_friction.size:
            friction = ground.find_friction(region_of_force)
            facets = np.array([_build_facets(float(mu)) for mu in friction])
        blocks[force_index, :, force_index] = facets @ ground.frame[region_of_force]
        # Force limits, eq. (8.23), and regions, eq. (8.24)
        max_force = self.task.body.force_limit / self.force_scale
        lower, upper = (np.empty(self.num_unknowns + len(rows)) for _ in range(2))
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
        return FixedContactQp(
            np.zeros((self.num_unknowns, self.num_unknowns)),
            np.zeros(self.num_unknowns),
            lower,
            upper,
            rows,
            np.zeros((knots + 1, STATE)),
            np.zeros((knots + 1, STATE, self.num_unknowns)),
        )

    def _build_force_hessian(self) -> Array:
        """Return the Hessian of force differences.

        The sum over ordered pairs of || f_s - f_t ||^2 is 2 (L sum f^2 - (sum f)^2) at each knot.
        """
        hessian = np.zeros((self.num_unknowns, self.num_unknowns))
        factor = 4.0 * self.task.weights.force_difference * self.force_scale**2
        write_force_cost(self.stand_knot, self.task.body.leg_count, factor, hessian)
        return hessian


@cache
def _build_facets(friction: float) -> Array:
    """Return the rows (FACETS, 3) of a pyramid inscribed in a friction cone about z."""
    angle = 2 * np.pi * (np.arange(FACETS) + 0.5) / FACETS
    slope = friction * np.cos(np.pi / FACETS)
    return np.column_stack([np.cos(angle), np.sin(angle), np.full(FACETS, -slope)])


def _solve_daqp(
    qp: FixedContactQp, unit: Array | None, sense: NDArray[np.int32], max_iterations: int
) -> tuple[Array, int, Mapping[str, Any]]:
    """Solve a QP by DAQP.

    Args:
        qp: The QP.
        unit: Units of the unknowns (Z,); None: 1.
        sense: Flags of bounds and rows.
        max_iterations: Limit on iterations.

    Returns:
        The solution, the exit flag and further facts.
    """
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
