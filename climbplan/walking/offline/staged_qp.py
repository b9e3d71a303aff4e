"""The program with all integers fixed, linearised, with states as unknowns: a sparse QP.

    minimise    1/2 v' H v + g' v
    subject to  x_{n+1} = A_n x_n + B_n f_n + C_n p + c_n  at every knot n,
                friction pyramids, force limits, regions, workspace boxes, goal

Unknowns v are forces f_n of standing legs, free footholds p, and states x_1 to x_N. It is the QP of
`fixed_contact_qp` before it is condensed (its states eliminated); the same functions write its
rows. Its matrices have as many entries as there are knots, so that PIQP (Schwan et al. 2023)
solves it in a time that is linear in the horizon. The time of the condensed QP grows with the cube,
but over short horizons it is faster.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.walking.kernels.parameters import (
    AffineStates,
    LinearisationPoint,
    QpBuffers,
    QpLayout,
    QpObjective,
    QpProblem,
    QpRows,
)
from climbplan.walking.kernels.qp_assembly import assemble_state_rows
from climbplan.walking.offline.fixed_contact_qp import (
    FOOT_SCALE,
    RIDGE,
    FixedContactProgram,
    WalkIterate,
)
from climbplan.walking.task.task import STATE, Gait, WalkTask

MIN_KNOTS = 24  # of horizons that are solved with states as unknowns
_ACCURACY = {"eps_abs": 1e-7, "eps_rel": 1e-8, "max_iter": 40}  # of PIQP
_FAR = 1e20  # sides beyond are none


class _MatrixEntries(NamedTuple):
    """Entries of a sparse matrix whose places do not change: those of values in column order."""

    order: IntArray  # (E,) of values
    pattern: sparse.csc_matrix  # its matrix, of any values
    sparsity: Any  # the same for CasADi


@dataclass(frozen=True)
class _StandingForces:
    """Forces of the QP: knot and leg (K,), and those on free footholds (K',) with their indices."""

    knot: IntArray
    leg: IntArray
    on_free: IntArray  # (K',) indices into the forces
    foothold: IntArray  # (K',)


class _Steps(NamedTuple):
    """Derivatives of states by the states before, and by forces and footholds in their units."""

    by_state: Array  # (N, 12, 12)
    by_force: Array  # (K, 3, 12)
    by_spot: Array  # (K', 2, 12)


class StagedContactProgram(FixedContactProgram):
    """The program of one gait over a long horizon, without joints.

    A QP that PIQP does not solve, and those after it, are left to the small dense QP, which also
    finds by how much workspaces have to be exceeded.
    """

    def __init__(self, task: WalkTask, gait: Gait, margin: float = 0.0) -> None:
        """Allocate the arrays of a gait, as `FixedContactProgram` does."""
        super().__init__(task, gait, margin)
        foothold = self.footing.foothold[self.stand_knot, self.stand_leg]
        on_free = np.flatnonzero(foothold >= 0)
        self._standing = _StandingForces(
            self.stand_knot, self.stand_leg, on_free, foothold[on_free]
        )
        self._row_knot, self._row_foothold = self._locate_workspace_rows()
        num_rows, width = len(self._row_knot), STATE + 2 * self.footing.count
        selector = np.zeros((task.knots + 1, STATE, width))
        selector[:, np.arange(STATE), np.arange(STATE)] = 1.0
        self._buffers = QpBuffers(
            self._next_state,
            self._derivatives,
            AffineStates(np.zeros((task.knots + 1, STATE)), selector),
            np.zeros((0, 0)),
            np.zeros(0),
            QpRows(np.zeros((num_rows, width)), np.zeros(num_rows), np.zeros(num_rows)),
        )
        self._fixed = sparse.coo_matrix(self._qp.rows[: self.num_fixed_rows])
        self._rows = self._locate_entries()
        self._hessian = self._build_hessian()
        self._diagonal = _find_diagonal(self._hessian)[: self.num_unknowns]
        self._solver = self._create_solver()
        self._is_solvable = True  # so far, by PIQP

    @staticmethod
    def suits(task: WalkTask) -> bool:
        """Return whether the horizon of a task is long, and its robot has no joints."""
        return task.knots >= MIN_KNOTS and task.legs is None

    def solve_qp(
        self,
        iterate: WalkIterate,
        elastic: bool = False,
        soft: bool = False,
        max_iterations: int = 2000,
        any_speed: bool = False,
    ) -> WalkIterate | None:
        """Solve the QP of the linearisation about an iterate, as `FixedContactProgram` does."""
        if self._is_solvable and not soft and self.num_unknowns:
            solution = self._solve_staged(iterate)
            if solution is not None:
                return solution
            self._is_solvable = False
        return super().solve_qp(iterate, elastic, soft, max_iterations, any_speed)

    def _solve_staged(self, iterate: WalkIterate) -> WalkIterate | None:
        """Solve the sparse QP; None where PIQP does not."""
        import casadi

        toes = self.compute_toes(iterate.state, iterate.spots)
        if self.raise_swing_heights(toes):
            toes = self.compute_toes(iterate.state, iterate.spots)
        values, lower, upper = self._build_rows(iterate, toes)
        if not np.isfinite(values).all() or (lower > upper).any():
            return None
        count = self.num_unknowns
        ends = np.stack([self._qp.lower[:count], self._qp.upper[:count]])
        low, high = np.full((2, self._rows.pattern.shape[1]), [[-np.inf], [np.inf]])
        low[:count], high[:count] = ends
        entries = self._hessian.data.copy()
        entries[self._diagonal] += RIDGE * (1.0 + self._compute_curvature(self._read_steps()))
        answer = self._solver(
            h=casadi.DM(self._hessian_sparsity, entries),
            g=self._build_gradient(),
            a=casadi.DM(self._rows.sparsity, values[self._rows.order]),
            lba=np.where(lower < -_FAR, -np.inf, lower),
            uba=np.where(upper > _FAR, np.inf, upper),
            lbx=low,
            ubx=high,
        )
        v = np.asarray(answer["x"], float).ravel()
        if not self._solver.stats()["success"] or not np.isfinite(v).all():
            return None
        self.num_iterations, self.is_elastic = 1, False
        force, spots = self.split_solution(v[:count])
        state = np.vstack([self.start.state, v[count:].reshape(-1, STATE)])
        return WalkIterate(state, force, spots)

    def _build_rows(self, iterate: WalkIterate, toes: Array) -> tuple[Array, Array, Array]:
        """Return values and sides of all rows: fixed ones, steps, workspaces, the goal."""
        layout = QpLayout(self._columns, self.force_scale, FOOT_SCALE, STATE, self.margin)
        objective = QpObjective(
            self._reference, self._weight, self.task.weights.motion, self._force_hessian, RIDGE
        )
        problem = QpProblem(
            self.task.body.parameters, self.horizon, self.placement, objective, layout
        )
        point = LinearisationPoint(iterate.state, iterate.force, iterate.spots)
        assemble_state_rows(problem, point, toes, self._buffers)
        block, index = self._buffers.block, np.flatnonzero(self._row_foothold >= 0)
        columns = STATE + 2 * self._row_foothold[index]
        on_footholds = np.stack([block.rows[index, columns + k] for k in range(2)], axis=1)
        step_values, step_sides = self._build_steps(self._read_steps(), iterate)
        goal = self.task.goal
        values = [self._fixed.data, step_values, block.rows[:, :STATE].ravel()]
        values += [on_footholds.ravel(), np.ones(2 * int(goal.is_set))]
        first = self.num_unknowns
        fixed = slice(first, first + self.num_fixed_rows)
        lower = [self._qp.lower[fixed], step_sides, block.lower]
        upper = [self._qp.upper[fixed], step_sides, block.upper]
        if goal.is_set:
            lower.append(np.asarray(goal.lower, float))
            upper.append(np.asarray(goal.upper, float))
        return np.concatenate(values), np.concatenate(lower), np.concatenate(upper)

    def _read_steps(self) -> _Steps:
        """Return the derivatives of the steps that were linearised last."""
        standing, jacobian = self._standing, self._derivatives
        toe, knot = STATE + 3 * standing.leg, standing.knot[:, None]
        arm = 3 * self.task.body.leg_count  # from a toe to its force
        by_force = jacobian[knot, (toe + arm)[:, None] + np.arange(3)]
        free = standing.on_free
        by_toe = jacobian[knot[free], toe[free][:, None] + np.arange(3)]
        by_spot = by_toe[:, :2] + self.tilt[standing.foothold][:, :, None] * by_toe[:, 2:]
        by_state = np.swapaxes(jacobian[:, :STATE], 1, 2)
        return _Steps(by_state, self.force_scale * by_force, FOOT_SCALE * by_spot)

    def _build_steps(self, steps: _Steps, iterate: WalkIterate) -> tuple[Array, Array]:
        """Return values and sides of x_{n+1} - A_n x_n - B_n f_n - C_n p = c_n."""
        standing, (by_state, by_force, by_spot) = self._standing, steps
        side = self._next_state - np.einsum("nij,nj->ni", by_state, iterate.state[:-1])
        force = iterate.force[standing.knot, standing.leg] / self.force_scale
        spots = iterate.spots[standing.foothold] / FOOT_SCALE
        np.subtract.at(side, standing.knot, np.einsum("kci,kc->ki", by_force, force))
        free_knot = standing.knot[standing.on_free]
        np.subtract.at(side, free_knot, np.einsum("kci,kc->ki", by_spot, spots))
        side[0] += by_state[0] @ self.start.state
        entries = (-by_state[1:], -by_force, -by_spot)
        return np.concatenate([np.ones(side.size), *map(np.ravel, entries)]), side.ravel()

    def _compute_curvature(self, steps: _Steps) -> Array:
        """Return (Z,) the diagonal of the dense QP's Hessian, without products across knots.

        With V_n = W + A_n' V_{n+1} A_n a force has the curvature B_n' V_{n+1} B_n.
        """
        standing, knots = self._standing, self.task.knots
        weight = np.zeros(STATE)
        weight[2:9] = 2.0 * self._weight
        weight[:3] += 2.0 * self.task.weights.motion
        later = np.empty((knots, STATE, STATE))  # V_{n+1}
        later[-1] = np.diag(weight)
        for n in range(knots - 1, 0, -1):
            A = steps.by_state[n]
            later[n - 1] = later[-1] + A.T @ later[n] @ A
        at_force, free = later[standing.knot], standing.on_free
        curvature = self._force_hessian.diagonal().copy()
        curvature[: self.foot_column] += np.einsum(
            "kci,kij,kcj->kc", steps.by_force, at_force, steps.by_force
        ).ravel()
        of_spots = np.einsum("kci,kij,kcj->kc", steps.by_spot, at_force[free], steps.by_spot)
        columns = self.foot_column + 2 * standing.foothold[:, None] + np.arange(2)
        np.add.at(curvature, columns, of_spots)
        return curvature

    def _locate_workspace_rows(self) -> tuple[IntArray, IntArray]:
        """Return knot and free foothold, -1 for none, of the rows that kernels write."""
        contact, foothold = self.gait.contact, self.footing.foothold
        knots, free = [], []
        for n in range(1, len(contact)):
            for leg in range(contact.shape[1]):
                is_leaving = self.task.workspace_over_stance and contact[n - 1, leg]
                if contact[n, leg] or is_leaving:
                    knots += 3 * [n]
                    free += 3 * [max(int(foothold[n if contact[n, leg] else n - 1, leg]), -1)]
        lifted = np.repeat(np.nonzero(~contact[1:])[0] + 1, 2)
        knot = np.concatenate([np.array(knots, int), lifted])
        return knot, np.concatenate([np.array(free, int), np.full(len(lifted), -1)])

    def _locate_entries(self) -> _MatrixEntries:
        """Return the places of the values of `_build_rows`."""
        knots, first_state = self.task.knots, self.num_unknowns
        state, step = np.arange(STATE), self.num_fixed_rows + np.arange(STATE * knots)
        rows, columns = [self._fixed.row], [self._fixed.col]

        def add(row: IntArray, column: IntArray) -> None:
            row, column = np.broadcast_arrays(row, column)
            rows.append(row.ravel())
            columns.append(column.ravel())

        add(step, first_state + np.arange(STATE * knots))
        by_knot = step.reshape(knots, STATE)
        states = first_state + np.arange(STATE * knots).reshape(knots, STATE)
        add(by_knot[1:, :, None], states[:-1, None, :])
        coordinates = np.arange(3)[None, :, None]
        forces = 3 * np.arange(self.num_forces)[:, None, None] + coordinates
        add(by_knot[self._standing.knot][:, None, :], forces)
        index = self._standing.foothold[:, None, None]
        spots = self.foot_column + 2 * index + coordinates[:, :2]
        add(by_knot[self._standing.knot[self._standing.on_free]][:, None, :], spots)
        begin = self.num_fixed_rows + STATE * knots
        number = begin + np.arange(len(self._row_knot))
        add(number[:, None], first_state + STATE * (self._row_knot[:, None] - 1) + state)
        free = np.flatnonzero(self._row_foothold >= 0)
        add(
            number[free][:, None],
            self.foot_column + 2 * self._row_foothold[free][:, None] + np.arange(2),
        )
        end = begin + len(number)
        if self.task.goal.is_set:
            add(end + np.arange(2), first_state + STATE * (knots - 1) + np.arange(2))
            end += 2
        shape = (end, first_state + STATE * knots)
        index = np.flatnonzero(self._build_rows(*self._sample_point())[0])
        return _order_entries(np.concatenate(rows), np.concatenate(columns), index, shape)

    def _sample_point(self) -> tuple[WalkIterate, Array]:
        """Return a point and its toes at which no entry is zero that is not zero everywhere."""
        rng, knots, legs = np.random.default_rng(0), self.task.knots, self.task.body.leg_count
        state = rng.uniform(0.1, 0.3, (knots + 1, STATE))
        force = self.force_scale * rng.uniform(0.5, 1.0, (knots, legs, 3))
        spots = rng.uniform(-1.0, 1.0, (self.footing.count, 2))
        return WalkIterate(state, force, spots), rng.uniform(-1.0, 1.0, (knots + 1, legs, 3))

    def _build_hessian(self) -> sparse.csc_matrix:
        """Return the Hessian of eq. (8.30), which no linearisation changes."""
        knots, weights = self.task.knots, self.task.weights
        diagonal = np.zeros((knots, STATE))
        diagonal[:, 2:9] = 2.0 * self._weight
        step = np.zeros(STATE)
        step[:3] = 2.0 * weights.motion
        links = sparse.diags([1.0, -1.0], [0, -1], shape=(knots, knots))
        states = sparse.diags(diagonal.ravel()) + sparse.kron(links.T @ links, sparse.diags(step))
        forces = sparse.coo_matrix(self._force_hessian)
        index = np.arange(self.num_unknowns)  # the whole diagonal has entries
        rows, columns = np.append(forces.row, index), np.append(forces.col, index)
        entries = np.append(forces.data, np.full(len(index), np.finfo(float).tiny))
        block = sparse.csc_matrix((entries, (rows, columns)), forces.shape)
        hessian = sparse.csc_matrix(sparse.block_diag([block, states]))
        hessian.sort_indices()
        return hessian

    def _create_solver(self) -> Any:
        """Return PIQP for these patterns."""
        import casadi

        self._hessian_sparsity = _create_sparsity(self._hessian)
        options: Any = {"error_on_fail": False, "piqp": _ACCURACY}
        patterns = {"h": self._hessian_sparsity, "a": self._rows.sparsity}
        return casadi.conic("staged", "piqp", patterns, options)

    def _build_gradient(self) -> Array:
        """Return the gradient of eq. (8.30) at v = 0."""
        gradient = np.zeros(self._rows.pattern.shape[1])
        states = gradient[self.num_unknowns :].reshape(-1, STATE)
        states[:, 2:9] = -2.0 * self._weight * self._reference
        states[0, :3] -= 2.0 * self.task.weights.motion * self.start.state[:3]
        return gradient


def _order_entries(
    rows: IntArray, columns: IntArray, index: IntArray, shape: tuple[int, int]
) -> _MatrixEntries:
    """Return selected entries, which are at different places, in the order of columns."""
    rows, columns = rows[index], columns[index]
    order = index[np.lexsort([rows, columns])]
    pattern = sparse.csc_matrix((np.ones(len(rows)), (rows, columns)), shape)
    assert pattern.nnz == len(rows)
    return _MatrixEntries(order, pattern, _create_sparsity(pattern))


def _find_diagonal(matrix: sparse.csc_matrix) -> IntArray:
    """Return the indices of the diagonal's entries among those of a sorted matrix."""
    column = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    return np.flatnonzero(matrix.indices == column)


def _create_sparsity(matrix: sparse.csc_matrix) -> Any:
    """Return the pattern of a matrix for CasADi."""
    import casadi

    matrix.sort_indices()
    height, width = map(int, matrix.shape)
    return casadi.Sparsity(height, width, matrix.indptr.tolist(), matrix.indices.tolist())
