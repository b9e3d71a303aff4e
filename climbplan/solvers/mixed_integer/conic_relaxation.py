"""Second-order cone programs of nodes: one instance over many boxes, solved by Clarabel.

    minimise 1/2 x'P x + q'x  subject to  M x + s = b, s in {0}, an orthant and second-order cones.

Variables that a box fixes are left out, since rows that pin a variable from both sides have no
interior, which interior-point methods need.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.result import FEASIBILITY

_FIXED = 1e-8  # width of a range that counts as a point
_EXACT = 1e-10  # accuracy of incumbents
_ACCURACY = 1e-8  # relative, of dual values as bounds
_MARGIN = 2.0  # of rows and cones, in units of a violation that is too large
_SOLVED = (clarabel.SolverStatus.Solved,)
_CLOSE = (*_SOLVED, clarabel.SolverStatus.AlmostSolved)

NodeStatus = Literal["solved", "infeasible", "unbounded", "unsolved"]


@dataclass(frozen=True)
class NodeSolution:
    """Solution of a relaxation."""

    status: NodeStatus
    x: Array  # (n,)
    bound: float  # dual value, less its accuracy


@dataclass(frozen=True)
class _Entries:
    """A sparse matrix by columns, of which some rows and columns are selected."""

    row: IntArray
    column: IntArray
    value: Array
    shape: tuple[int, int]

    @classmethod
    def of(cls, matrix: Any) -> _Entries:
        """Return the entries column by column."""
        entries = sparse.csc_matrix(matrix)
        entries.sort_indices()
        column = np.repeat(np.arange(entries.shape[1]), np.diff(entries.indptr))
        return cls(entries.indices.astype(np.int64), column, entries.data, entries.shape)

    def select(self, rows: BoolArray, columns: BoolArray) -> sparse.csc_matrix:
        """Return the submatrix of masks."""
        chosen = rows[self.row] & columns[self.column]
        new_row, new_column = np.cumsum(rows) - 1, np.cumsum(columns) - 1
        num_rows, num_columns = int(rows.sum()), int(columns.sum())
        lengths = np.bincount(new_column[self.column[chosen]], minlength=num_columns)
        indptr = np.concatenate([[0], np.cumsum(lengths)])
        return sparse.csc_matrix(
            (self.value[chosen], new_row[self.row[chosen]], indptr), shape=(num_rows, num_columns)
        )


class ConicRelaxation:
    """The relaxations of an instance over boxes.

    Args:
        instance: Convex instance of rows, balls and cones; its integers count as continuous.
    """

    def __init__(self, instance: Instance) -> None:
        self._instance = instance
        n, A = instance.size, sparse.csr_matrix(instance.A)
        low, high = instance.row_lower, instance.row_upper
        equal = np.isfinite(low) & (low == high)
        above, below = np.isfinite(high) & ~equal, np.isfinite(low) & ~equal
        blocks = [A[equal], A[above], -A[below], sparse.identity(n), -sparse.identity(n)]
        sides = [low[equal], high[above], -low[below], np.zeros(2 * n)]
        self._num_equal = int(equal.sum())
        self._num_linear = self._num_equal + int(above.sum() + below.sum())
        self._cone_sizes: list[int] = []
        for balls in instance.balls:
            matrix, side = _stack_cones(balls)
            blocks.append(matrix)
            sides.append(side)
            self._cone_sizes += [balls.f.shape[1] + 1] * balls.count
        self._M = sparse.vstack(blocks).tocsr()
        self._b = np.concatenate(sides)
        heads = np.cumsum([0, *self._cone_sizes])[:-1] + self._num_linear + 2 * n
        # Rows that a margin tightens: inequalities, bounds are clipped, and heads of cones
        self._tightened = np.zeros(len(self._b))
        self._tightened[self._num_equal : self._num_linear] = 1.0
        self._tightened[heads.astype(np.int64)] = 1.0
        self._entries, self._curvature = _Entries.of(self._M), _Entries.of(sparse.triu(instance.P))
        self._settings = _create_settings(None)
        self._exact_settings = _create_settings(_EXACT)

    def solve(self, lower: Array, upper: Array) -> NodeSolution:
        """Solve the relaxation over a box.

        Args:
            lower: (n,) lower bounds.
            upper: (n,) upper bounds.
        """
        return self._solve(lower, upper, self._settings, 0.0)

    def solve_exactly(self, lower: Array, upper: Array, tolerance: float) -> Array | None:
        """Return a solution whose rows hold up to a tolerance, None where there is none.

        Args:
            lower: (n,) lower bounds, equal to the upper ones for integers.
            upper: (n,) upper bounds.
            tolerance: Largest violation of the instance.
        """
        margin, integer = 0.0, self._instance.integer
        for _ in range(2):
            smallest = np.inf
            # The tighter accuracy is sometimes out of reach, and leaves a point further off
            for options in (self._exact_settings, self._settings):
                solution = self._solve(lower, upper, options, margin)
                if solution.status != "solved":
                    continue
                x = np.where(integer, np.round(solution.x), solution.x)
                violation = self._instance.violation(x)
                if violation <= tolerance:
                    return x
                smallest = min(smallest, violation)
            if not np.isfinite(smallest):
                return None
            margin = _MARGIN * smallest
        return None

    def _solve(self, lower: Array, upper: Array, options: Any, margin: float) -> NodeSolution:
        """Solve over a box, with inequalities tightened by a margin."""
        instance = self._instance
        n = instance.size
        is_free = upper - lower > _FIXED
        x = np.zeros(n)
        x[~is_free] = 0.5 * (lower[~is_free] + upper[~is_free])
        x = np.where(~is_free & instance.integer, np.round(x), x)
        g = instance.P @ x
        constant = float(0.5 * x @ g + instance.q @ x) + instance.constant
        b = self._b - margin * self._tightened
        bounds = slice(self._num_linear, self._num_linear + 2 * n)
        b[bounds] = np.concatenate([upper, -lower])
        has_row = np.ones(len(b), bool)
        has_row[bounds] = np.isfinite(b[bounds]) & np.concatenate([is_free, is_free])
        b -= self._M @ x
        if not self._drop_constant_rows(is_free, has_row, b):
            return NodeSolution("infeasible", x, np.inf)
        if not is_free.any():
            return NodeSolution("solved", x, constant)
        program = _NodeProgram(
            P=self._curvature.select(is_free, is_free),
            q=(g + instance.q)[is_free],
            A=self._entries.select(has_row, is_free),
            b=b[has_row],
            num_equal=int(has_row[: self._num_equal].sum()),
            num_linear=int(has_row.sum()) - sum(self._cone_sizes),
            cone_sizes=self._cone_sizes,
        )
        answer = program.solve(options)
        if answer.status in _SOLVED:
            x[is_free] = np.clip(answer.x, lower[is_free], upper[is_free])
            return NodeSolution("solved", x, _read_bound(answer) + constant)
        if answer.status == clarabel.SolverStatus.PrimalInfeasible:
            return NodeSolution("infeasible", x, np.inf)
        if answer.status == clarabel.SolverStatus.DualInfeasible:
            return NodeSolution("unbounded", x, -np.inf)
        if program.compute_least_violation(options) > FEASIBILITY:
            return NodeSolution("infeasible", x, np.inf)
        if answer.status in _CLOSE:
            x[is_free] = np.clip(answer.x, lower[is_free], upper[is_free])
            bound = _read_bound(answer) + constant if answer.r_dual <= _ACCURACY else -np.inf
            return NodeSolution("solved", x, bound)
        return NodeSolution("unsolved", x, -np.inf)

    def _drop_constant_rows(self, is_free: BoolArray, has_row: BoolArray, b: Array) -> bool:
        """Drop linear rows of fixed variables alone; return whether all of them hold.

        Fixed variables are exact up to rounding, so such rows would leave no interior.
        """
        entries, end = self._entries, self._num_linear
        num_free = np.bincount(entries.row[is_free[entries.column]], minlength=len(b))
        is_constant = num_free[:end] == 0
        has_row[:end] = ~is_constant
        equal = np.arange(end) < self._num_equal
        violation = np.where(equal, np.abs(b[:end]), -b[:end])
        return not (violation[is_constant] > FEASIBILITY).any()


@dataclass(frozen=True)
class _NodeProgram:
    """Minimise 1/2 x'P x + q'x subject to A x + s = b: equations, inequalities, cones."""

    P: sparse.csc_matrix  # upper triangle
    q: Array
    A: sparse.csc_matrix
    b: Array
    num_equal: int
    num_linear: int  # equations and inequalities
    cone_sizes: list[int]

    def solve(self, options: Any) -> Any:
        """Return Clarabel's answer."""
        cones = [
            clarabel.ZeroConeT(self.num_equal),
            clarabel.NonnegativeConeT(self.num_linear - self.num_equal),
            *(clarabel.SecondOrderConeT(size) for size in self.cone_sizes),
        ]
        return clarabel.DefaultSolver(self.P, self.q, self.A, self.b, cones, options).solve()

    def compute_least_violation(self, options: Any) -> float:
        """Return a lower bound on the violation of inequalities and cones; 0 if none is found.

        This program has an interior even where the node's has none, or is hardly infeasible.
        """
        heads = self.num_linear + np.cumsum([0, *self.cone_sizes])[:-1]
        slack = np.zeros((len(self.b), 1))
        slack[self.num_equal : self.num_linear] = slack[heads.astype(np.int64)] = -1.0
        A = sparse.hstack([self.A, sparse.csc_matrix(slack)])
        nonnegative = sparse.csr_matrix(([-1.0], ([0], [A.shape[1] - 1])), shape=(1, A.shape[1]))
        rows, size = A.tocsr(), A.shape[1]
        elastic = _NodeProgram(
            P=sparse.csc_matrix((size, size)),
            q=np.append(np.zeros(size - 1), 1.0),
            A=sparse.vstack([rows[: self.num_equal], nonnegative, rows[self.num_equal :]]).tocsc(),
            b=np.insert(self.b, self.num_equal, 0.0),
            num_equal=self.num_equal,
            num_linear=self.num_linear + 1,
            cone_sizes=self.cone_sizes,
        )
        answer = elastic.solve(options)
        if answer.status == clarabel.SolverStatus.PrimalInfeasible:
            return np.inf
        return float(answer.obj_val_dual) if answer.status in _CLOSE else 0.0


def _read_bound(answer: Any) -> float:
    """Return the dual value of an answer, less its accuracy."""
    value = float(answer.obj_val_dual)
    return value - _ACCURACY * max(1.0, abs(value))


def _stack_cones(balls: Any) -> tuple[sparse.csr_matrix, Array]:
    """Return M and b of b - M x in second-order cones, the limit of each cone first."""
    K, d = balls.f.shape
    n = balls.F.shape[1]
    entry = sparse.coo_matrix(balls.F)
    row, shape = entry.row + entry.row // d + 1, (K * (d + 1), n)
    matrix = sparse.csr_matrix((-entry.data, (row, entry.col)), shape=shape)
    if balls.slope is not None:
        limit = sparse.coo_matrix(balls.slope)
        matrix += sparse.csr_matrix((-limit.data, (limit.row * (d + 1), limit.col)), shape=shape)
    return matrix, np.column_stack([balls.radius, balls.f]).ravel()


def _create_settings(accuracy: float | None) -> Any:
    """Return quiet settings of Clarabel, with a tighter accuracy where one is given."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False
    settings.max_threads = 1
    if accuracy is not None:
        settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = accuracy
    return settings
