"""The online program of X. Lin: a convex QP with McCormick relaxations in the neighbour's regions.

Chapter 8.2.1.2, all integers fixed: sines and cosines lie between chords and tangents, products
within the McCormick planes of eq. (8.26). The QP is sparse and large, and solved by OSQP as
published. Its solution need not obey the dynamics: `gait_solver.py` validates it.

Published methods, and equation and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import osqp
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.linear_rows import Block, LinearRows, Terms
from climbplan.program.residuals import BlockResidual, compute_violation
from climbplan.solvers.convex.osqp import run_osqp
from climbplan.walking.kernels.contact_phases import HELD, SWINGING
from climbplan.walking.offline.fixed_contact_qp import FACETS, FixedContactProgram, WalkIterate
from climbplan.walking.published.layout import (
    ENTRIES,
    SQUARES,
    VariableLayout,
    select_tracked_columns,
)
from climbplan.walking.task.task import POSITION


class ParametricRows:
    """Rows with a fixed sparsity pattern and changing coefficients, in their original order."""

    def __init__(self, stated: LinearRows) -> None:
        row, column, self.value = stated.entries()
        self.low, self.high, self.names = stated.row_lower, stated.row_upper, stated.names
        count = len(self.low)
        slots, self._slot = np.unique(column * count + row, return_inverse=True)  # by columns
        rows, columns = slots % count, slots // count
        unknowns = len(stated.lower)
        start = np.searchsorted(columns, np.arange(unknowns + 1))
        self.matrix = sparse.csc_matrix(
            (np.zeros(len(slots)), rows, start), shape=(count, unknowns)
        )
        self.refresh()

    def refresh(self) -> None:
        """Write the coefficients into the matrix."""
        self.matrix.data[:] = np.bincount(
            self._slot, weights=self.value, minlength=len(self.matrix.data)
        )

    def compute_residuals(self, x: Array) -> tuple[BlockResidual, ...]:
        """Return the largest violation of each block at x (n,), with the present coefficients."""
        return self.names.residuals(compute_violation(self.matrix @ x, self.low, self.high))


TOLERANCE = 1e-3  # absolute and relative, of OSQP: its default
_MAX_ITERATIONS = 4000
_REGULARISATION = 1e-9  # curvature of unknowns without cost


@dataclass(frozen=True)
class PublishedAnswer:
    """The solution of OSQP and its statistics."""

    iterate: WalkIterate | None  # None unless solved
    status: str
    iterations: int
    values: Array | None = None  # of all unknowns of the layout, with `iterate`


class PublishedProgram:
    """The online program of X. Lin (UCLA 2022) for a gait."""

    def __init__(
        self, program: FixedContactProgram, neighbour_region_fraction: float = 0.0
    ) -> None:
        """State all rows of the program.

        Args:
            program: the fixed-gait program; gives task, gait, margin and toes.
            neighbour_region_fraction: fraction of regions adjacent to the neighbour's that is
                allowed, too.
        """
        self.neighbour_region_fraction = neighbour_region_fraction
        self.program = program  # with the start of each solve
        self.layout = VariableLayout(program.task, program.gait, program.footing)
        rows = LinearRows()
        rows.columns((self.layout.size,), -np.inf, np.inf)
        self._begin = self._add_dynamics(rows)
        self.arms, self.reaches = self._add_feet(rows)
        self._add_friction(rows)
        trig, angle = self.layout.trig, np.tile(self.layout.angle, (1, 2))
        lines = ((trig.ravel(), 1.0), (angle.ravel(), 1.0))
        self.lines = [rows.block("envelopes.angles", lines) for _ in range(3)]
        w, self._x, self._y = self.layout.list_products()
        terms = ((w, 1.0), (self._x, 1.0), (self._y, 1.0))
        self.planes = [rows.block("envelopes.products", terms) for _ in range(4)]
        self._boxed = np.unique(np.concatenate([self._x, self._y]))
        self._box = rows.block("envelopes.cells", ((self._boxed, 1.0),))
        self.rows = ParametricRows(rows)
        self._hessian, self._gradient = self._build_objective()
        self._solver: osqp.OSQP | None = None

    def solve(self, neighbour: WalkIterate) -> PublishedAnswer:
        """Solve the program in the regions of a neighbour's motion."""
        program, layout = self.program, self.layout
        toes = program.compute_toes(neighbour.state, neighbour.spots)
        state = neighbour.state.copy()
        state[0] = program.start.state
        values = layout.evaluate_motion(state, neighbour.force, toes, neighbour.spots)
        low, high = layout.compute_cells(values, self.neighbour_region_fraction)
        self.write_rows(low, high)
        rows = self.rows
        if self._solver is None:
            self._solver = osqp.OSQP()
            self._solver.setup(
                self._hessian,
                self._gradient,
                rows.matrix,
                rows.low,
                rows.high,
                eps_abs=TOLERANCE,
                eps_rel=TOLERANCE,
                max_iter=_MAX_ITERATIONS,
                polishing=False,
                verbose=False,
            )
        else:
            self._solver.update(l=rows.low, u=rows.high, Ax=rows.matrix.data)
        self._solver.warm_start(x=values, y=np.zeros(len(rows.low)))
        osqp_result = run_osqp(self._solver, rows.matrix.nnz)
        if osqp_result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            return PublishedAnswer(None, str(osqp_result.info.status), int(osqp_result.info.iter))
        iterate = self._extract_iterate(osqp_result.x)
        return PublishedAnswer(
            iterate, "solved", int(osqp_result.info.iter), np.array(osqp_result.x)
        )

    def _extract_iterate(self, x: Array) -> WalkIterate:
        """Return states, forces and footholds of a solution."""
        layout = self.layout
        force = np.zeros((layout.task.knots, layout.task.body.leg_count, 3))
        force[layout.stand_knot, layout.stand_leg] = x[layout.force] * layout.force_unit
        return WalkIterate(x[layout.state], force, x[layout.spot])

    def write_rows(self, low: Array, high: Array) -> None:
        """Write the coefficients for regions from low to high (n,), clipped to the workspace."""
        layout, rows, program = self.layout, self.rows, self.program
        self._write_equality(self._begin, program.start.state)
        stance_foothold = program.footing.foothold[layout.stand_knot, layout.stand_leg]
        ground = program.height[layout.stand_knot, layout.stand_leg]
        toes = program.start.toes[layout.stand_leg]
        for j in range(3):
            free = ground if j == 2 else 0.0
            self._write_equality(self.arms[j], np.where(stance_foothold == HELD, toes[:, j], free))
        for k, blocks in enumerate(self.reaches):
            reach = layout.reaches[k]
            for j, block in blocks:
                is_held = reach.foothold == HELD
                free = program.height[reach.knot, reach.leg] if j == 2 else 0.0
                if reach.lifts:
                    free = program.height[reach.knot - 1, reach.leg] if j == 2 else 0.0
                self._write_equality(block, program.start.toes[reach.leg, j] if is_held else free)
        self._write_lines(low, high)
        x, y = self._x, self._y
        xl, xu, yl, yu = low[x], high[x], low[y], high[y]
        # eq. (8.26): w - b x - a y against - a b, from below and from above
        for k, (a, b) in enumerate(((xl, yl), (xu, yu), (xu, yl), (xl, yu))):
            block = self.planes[k]
            by_row = rows.value[block.values].reshape(-1, 3)
            by_row[:, 1], by_row[:, 2] = -b, -a
            rows.low[block.rows] = -a * b if k < 2 else -np.inf
            rows.high[block.rows] = np.inf if k < 2 else -a * b
        # Workspace boxes, eqs. (8.20), (8.21)
        half = layout.task.body.toe_half - program.margin
        low[layout.toe] = np.clip(low[layout.toe], -half, half)
        high[layout.toe] = np.clip(high[layout.toe], -half, half)
        rows.low[self._box.rows], rows.high[self._box.rows] = low[self._boxed], high[self._boxed]
        rows.refresh()

    def _write_equality(self, block: Block, value: Array | float) -> None:
        """Set both bounds of a block."""
        self.rows.low[block.rows] = self.rows.high[block.rows] = value

    def _write_lines(self, low: Array, high: Array) -> None:
        """Bound sines and cosines by the chord of their region and the tangents at its ends."""
        angle, rows = self.layout.angle, self.rows
        begin, end = (np.tile(ends[angle], (1, 2)).ravel() for ends in (low, high))
        sine = np.tile(np.arange(6) < 3, len(angle))
        f = [np.where(sine, np.sin(argument), np.cos(argument)) for argument in (begin, end)]
        slope = [np.where(sine, np.cos(argument), -np.sin(argument)) for argument in (begin, end)]
        wide = end - begin
        chord = np.where(wide > 1e-9, (f[1] - f[0]) / np.maximum(wide, 1e-9), slope[0])
        hollow = sine & (begin < -1e-12) & (end < 1e-12)  # a convex piece: the sine below zero
        lines = ((chord, begin, f[0]), (slope[0], begin, f[0]), (slope[1], end, f[1]))
        # In a region around zero the sine is neither convex nor concave: its slope bounds it.
        both = sine & (begin < -1e-12) & (end > 1e-12)
        min_slope = np.minimum(*slope)
        for k, (block, (m, argument, value)) in enumerate(zip(self.lines, lines, strict=True)):
            by_angle = rows.value[block.values].reshape(-1, 2)[:, 1]
            by_angle[:] = -m
            above = hollow if k else ~hollow
            rows.low[block.rows] = np.where(above, value - m * argument, -np.inf)
            rows.high[block.rows] = np.where(above, np.inf, value - m * argument)
            steep = min_slope if k == 0 else np.ones(len(min_slope))
            by_angle[both] = -steep[both]
            ends = f[0] - steep * begin, f[1] - steep * end
            rows.low[block.rows][both] = np.minimum(*ends)[both]
            rows.high[block.rows][both] = np.maximum(*ends)[both]

    def _add_dynamics(self, rows: LinearRows) -> Block:
        """Add eqs. (8.14) to (8.19) and return the rows of the first state."""
        layout = self.layout
        task, x = layout.task, layout.state
        body, dt = task.body, task.dt
        weight_after = 0.5 if layout.mean else 0.0  # of the later knot in averages over an interval
        attitude = partial(rows.block, "dynamics.attitude")
        begin = rows.block("start.state", ((x[0], 1.0),))
        now, then = x[:-1], x[1:]
        for k in range(3):
            p, v, angle, spin = k, 3 + k, 6 + k, 9 + k
            displacement = ((now[:, v], -dt * (1 - weight_after)), (then[:, v], -dt * weight_after))
            rows.block("dynamics.position", ((then[:, p], 1.0), (now[:, p], -1.0), *displacement))
            for n in range(task.knots):
                pushes = layout.force[layout.stand_knot == n, k]
                scale = -dt * layout.force_unit / body.mass
                terms = [(np.array([f]), scale) for f in pushes]
                weight = -dt * body.gravity if k == 2 else 0.0
                terms += [(then[n : n + 1, v], 1.0), (now[n : n + 1, v], -1.0)]
                rows.block("dynamics.velocity", terms, weight)
            attitude(((then[:, angle], 1.0), (now[:, angle], -1.0), (layout.rate[:, k], -dt)))
            middle = ((now[:, spin], weight_after - 1.0), (then[:, spin], -weight_after))
            attitude(((layout.spin[:, k], 1.0), *middle))
            attitude(((layout.angle[: task.knots + 1, k], 1.0), (x[:, angle], -1.0)))
            if layout.mean:
                halves = ((now[:, angle], -0.5), (then[:, angle], -0.5))
                attitude(((layout.angle[task.knots + 1 :, k], 1.0), *halves))
        # Angular velocity by Euler rates, eq. (8.17)
        turning, swept, yaw_rate = layout.spin, layout.swept, layout.rate[:, 2]
        attitude(((turning[:, 0], 1.0), (swept[:, 0], -1.0), (swept[:, 1], 1.0)))
        attitude(((turning[:, 1], 1.0), (swept[:, 2], -1.0), (swept[:, 3], -1.0)))
        attitude(((turning[:, 2], 1.0), (yaw_rate, -1.0), (swept[:, 4], 1.0)))
        # Entries of R, eq. (8.16)
        factors = np.concatenate([layout.pair, layout.triple, layout.trig[:, 1:2]], axis=1)
        for entry, signs in enumerate(ENTRIES):
            sums = [(factors[:, k], -float(sign)) for k, sign in signs]
            attitude(((layout.turn[:, entry], 1.0), *sums))
        self._add_rotational_dynamics(rows)
        return begin

    def _add_rotational_dynamics(self, rows: LinearRows) -> None:
        """Add eq. (8.15) as published, with the inertia of the world frame."""
        layout = self.layout
        body, dt, x = layout.task.body, layout.task.dt, layout.state
        turn = np.zeros((3, len(SQUARES)))  # spin x (inertia spin) by squares
        for k, (first, second) in enumerate(SQUARES):
            first_axis, second_axis = np.eye(3)[first], np.eye(3)[second]
            turn[:, k] = np.cross(first_axis, body.inertia @ second_axis)
            if first != second:
                turn[:, k] += np.cross(second_axis, body.inertia @ first_axis)
        for n in range(layout.task.knots):
            legs = layout.stand_knot == n
            for i in range(3):
                terms: list[Terms] = []
                for j in range(3):
                    if body.inertia[i, j]:
                        terms.append((x[n + 1 : n + 2, 9 + j], body.inertia[i, j] / dt))
                        terms.append((x[n : n + 1, 9 + j], -body.inertia[i, j] / dt))
                terms += [(layout.square[n, k : k + 1], turn[i, k]) for k in range(len(SQUARES))]
                for moment in layout.moment[legs]:
                    terms.append((moment[2 * i : 2 * i + 1], -layout.force_unit))
                    terms.append((moment[2 * i + 1 : 2 * i + 2], layout.force_unit))
                rows.block("dynamics.angular_velocity", terms)

    def _add_feet(self, rows: LinearRows) -> tuple[list[Block], list[list[tuple[int, Block]]]]:
        """Add moment arms of forces, and toes in the body at knots, eqs. (8.20), (8.21)."""
        layout, footing = self.layout, self.program.footing
        weight_after = 0.5 if layout.mean else 0.0
        stance_foothold = footing.foothold[layout.stand_knot, layout.stand_leg]
        now, then = layout.state[layout.stand_knot], layout.state[layout.stand_knot + 1]
        arms = []
        for j in range(3):
            terms: list[Terms] = [(layout.arm[:, j], 1.0)]
            terms += [(now[:, j], 1.0 - weight_after), (then[:, j], weight_after)]
            if j < 2 and footing.count:
                free = np.where(stance_foothold >= 0, -1.0, 0.0)
                terms.append((layout.spot[np.maximum(stance_foothold, 0), j], free))
            arms.append(rows.block("dynamics.angular_velocity", terms))
        reaches = []
        for k, reach in enumerate(layout.reaches):
            blocks = []
            for j in range(3):
                if j < 2 and reach.foothold == SWINGING:
                    continue  # it may be anywhere in its box
                entry = slice(3 * j, 3 * j + 3)
                center = layout.task.body.toe_center[reach.leg]
                rotated, turn = layout.rotated_toe[k, entry], layout.turn[reach.knot, entry]
                terms = [(layout.state[reach.knot, j : j + 1], 1.0)]
                terms += [(rotated[i : i + 1], 1.0) for i in range(3)]
                terms += [(turn[i : i + 1], center[i]) for i in range(3)]
                if j < 2 and reach.foothold >= 0:
                    terms.append((layout.spot[reach.foothold, j : j + 1], -1.0))
                blocks.append((j, rows.block("workspace.toe", terms)))
            reaches.append(blocks)
        return arms, reaches

    def _add_friction(self, rows: LinearRows) -> None:
        """Add eq. (8.18) as pyramids inside the friction cones."""
        force = self.layout.force
        slope = self.layout.task.ground.friction * np.cos(np.pi / FACETS)
        for angle in 2 * np.pi * (np.arange(FACETS) + 0.5) / FACETS:
            sides = ((force[:, 0], np.cos(angle)), (force[:, 1], np.sin(angle)))
            rows.block("force.friction", (*sides, (force[:, 2], -slope)), -np.inf, 0.0)

    def _build_objective(self) -> tuple[sparse.csc_matrix, Array]:
        """Return eq. (8.30): upper triangle of the Hessian, and the gradient."""
        layout, task = self.layout, self.layout.task
        weights, reference = task.weights, task.reference
        size = layout.size
        hessian: Any = sparse.lil_matrix((size, size))
        hessian.setdiag(_REGULARISATION)
        gradient = np.zeros(size)
        weight = np.concatenate([[weights.height], weights.velocity, weights.angles])
        references = np.column_stack([reference.height, reference.velocity, reference.euler])
        for columns, goal in zip(select_tracked_columns(layout), references, strict=True):
            for column, w, target in zip(columns, weight, goal, strict=True):
                hessian[column, column] += 2 * w
                gradient[column] -= 2 * w * target
        before, after = layout.state[:-1, POSITION].ravel(), layout.state[1:, POSITION].ravel()
        for a, b in zip(before, after, strict=True):
            if weights.motion:
                hessian[a, a] += 2 * weights.motion
                hessian[b, b] += 2 * weights.motion
                hessian[a, b] -= 2 * weights.motion
        # Sum over ordered pairs of || f_s - f_t ||^2 = 2 (L sum f^2 - (sum f)^2) at each knot
        factor = 4.0 * weights.force_difference * layout.force_unit**2
        for n in range(task.knots):
            legs = layout.force[layout.stand_knot == n]
            for k in range(3):
                for s, force in enumerate(legs[:, k]):
                    hessian[force, force] += factor * (task.body.leg_count - 1)
                    for other_force in legs[s + 1 :, k]:
                        hessian[force, other_force] -= factor
        return sparse.csc_matrix(hessian), gradient
