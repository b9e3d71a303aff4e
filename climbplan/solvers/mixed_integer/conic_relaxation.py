"""Second-order cone programs of nodes: one instance over many boxes, solved by Clarabel.

    minimise 1/2 x'P x + q'x  subject to  M x + s = b, s in {0}, an orthant and second-order cones.

Variables that a box fixes are left out, since rows that pin a variable from both sides have no
interior, which interior-point methods need.

Bounds and infeasibility do not rest on the solver's accuracy: any z in the dual cone has

    1/2 x'P x + q'x  >=  -1/2 p'P p - b'z + min over the box of (q + P p + M'z)'x

for every feasible x and any p (weak duality), so the solver's z is projected onto the dual cone and
the right side is evaluated with its rounding error (Jansson, "Rigorous lower and upper bounds in
linear programming", 2004). Without the cost, a positive value proves that the box is empty. Where a
variable has no bound on the side in question, a slope within the solver's accuracy counts as zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.certificates.rounding import bound_error
from climbplan.program.instance import Instance
from climbplan.solvers.result import FEASIBILITY

_FIXED = 1e-8  # width of a range that counts as a point, relative to the instance's if that is < 1
_EXACT = 1e-10  # accuracy of incumbents
_ACCURACY = 1e-8  # relative, of slopes along directions without bounds
_LOSS = 1e-7  # relative distance of a bound from the dual value that calls for a tighter accuracy
_LARGE = 1e3  # largest violation of an elastic program
_MARGIN = 2.0  # of rows and cones, in units of a violation that is too large
_SOLVED = (clarabel.SolverStatus.Solved,)
_CLOSE = (*_SOLVED, clarabel.SolverStatus.AlmostSolved)

NodeStatus = Literal["solved", "infeasible", "unbounded", "unsolved"]


@dataclass(frozen=True)
class NodeSolution:
    """Solution of a relaxation."""

    status: NodeStatus
    x: Array  # (n,)
    bound: float  # proved by the solver's multipliers


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
        self._thin = _FIXED * np.minimum(1.0, instance.upper - instance.lower)
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
        is_free = upper - lower > self._thin
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
            if self._compute_cone_violation(b) > FEASIBILITY:
                return NodeSolution("infeasible", x, np.inf)
            return NodeSolution("solved", x, constant)
        program = _NodeProgram(
            P=self._curvature.select(is_free, is_free),
            q=(g + instance.q)[is_free],
            A=self._entries.select(has_row, is_free),
            b=b[has_row],
            num_equal=int(has_row[: self._num_equal].sum()),
            num_linear=int(has_row.sum()) - sum(self._cone_sizes),
            num_bounds=int(has_row[bounds].sum()),
            cone_sizes=self._cone_sizes,
        )
        low, high = lower[is_free], upper[is_free]
        answer = program.solve(options)
        if answer.status == clarabel.SolverStatus.DualInfeasible:
            return NodeSolution("unbounded", x, -np.inf)
        if answer.status not in _SOLVED and self._is_empty(program, answer, low, high, options):
            return NodeSolution("infeasible", x, np.inf)
        if answer.status not in _CLOSE:
            return NodeSolution("unsolved", x, -np.inf)
        x[is_free] = np.clip(answer.x, low, high)
        bound = program.compute_bound(answer, low, high)
        value = float(answer.obj_val_dual)
        if options is self._settings and value - bound > _LOSS * max(1.0, abs(value + constant)):
            precise = program.solve(self._exact_settings)
            bound = max(bound, program.compute_bound(precise, low, high))
        return NodeSolution("solved", x, bound + constant)

    def _is_empty(
        self, program: _NodeProgram, answer: Any, lower: Array, upper: Array, options: Any
    ) -> bool:
        """Return whether multipliers prove that no point is feasible, up to `FEASIBILITY`."""
        if answer.status == clarabel.SolverStatus.PrimalInfeasible:
            z = np.array(answer.z)
            z /= max(float(np.abs(z).max(initial=0.0)), 1e-300)
            if program.evaluate(z, None, lower, upper) > 0.0:
                return True
        return program.compute_least_violation(options, lower, upper) > FEASIBILITY

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

    def _compute_cone_violation(self, b: Array) -> float:
        """Return the largest violation of cones whose variables are all fixed, so that b is s."""
        end, worst = len(b), 0.0
        for size in reversed(self._cone_sizes):
            limit, vector = b[end - size], b[end - size + 1 : end]
            worst = max(worst, float(np.linalg.norm(vector) - limit))
            end -= size
        return worst


@dataclass(frozen=True)
class _NodeProgram:
    """Minimise 1/2 x'P x + q'x subject to A x + s = b: equations, inequalities, cones."""

    P: sparse.csc_matrix  # upper triangle
    q: Array
    A: sparse.csc_matrix
    b: Array
    num_equal: int
    num_linear: int  # equations and inequalities
    num_bounds: int  # inequalities that are bounds, the last ones
    cone_sizes: list[int]

    def compute_bound(self, answer: Any, lower: Array, upper: Array) -> float:
        """Return the bound that an answer's multipliers prove over a box, -inf where none."""
        if answer.status not in _CLOSE:
            return -np.inf
        return self.evaluate(np.array(answer.z), np.array(answer.x), lower, upper)

    def evaluate(self, z: Array, point: Array | None, lower: Array, upper: Array) -> float:
        """Return the least value of the Lagrangian over a box; without a point less the cost.

        Args:
            z: (m,) multipliers of rows A x + s = b, projected onto the dual cone.
            point: (n,) where the cost is linearised.
            lower: (n,) bounds.
            upper: (n,) bounds.
        """
        z = self._project(z)
        slope, sizes = _sum_columns(self.A, self.A.data * z[self.A.indices])
        terms, constant = len(z) + 2 * len(lower) + 8, -float(self.b @ z)
        constant_size = float(np.abs(self.b) @ np.abs(z))
        if point is not None:
            curved, curved_size = _multiply_symmetric(self.P, point)
            slope, sizes = slope + self.q + curved, sizes + np.abs(self.q) + curved_size
            constant -= 0.5 * float(point @ curved)
            constant_size += float(np.abs(point) @ curved_size)
        error = bound_error(terms, sizes)
        if not (np.isfinite(slope).all() and np.isfinite(constant)):
            return -np.inf
        ends = np.where(slope > 0.0, lower, upper)
        is_open = ~np.isfinite(ends)
        if (np.abs(slope[is_open]) > _ACCURACY * (1.0 + sizes[is_open])).any():
            return -np.inf
        reach = np.maximum(np.abs(lower), np.abs(upper))
        reach = np.where(np.isfinite(reach), reach, np.abs(ends))[~is_open]
        values = slope[~is_open] * ends[~is_open] - error[~is_open] * reach
        total = constant + float(values.sum())
        size = constant_size + float(np.abs(values).sum())
        return total - float(bound_error(terms, size))

    def _project(self, z: Array) -> Array:
        """Return multipliers in the dual cone, without those of bounds, which boxes replace."""
        z = z.copy()
        inequalities = slice(self.num_equal, self.num_linear)
        z[inequalities] = np.maximum(z[inequalities], 0.0)
        z[self.num_linear - self.num_bounds : self.num_linear] = 0.0
        if self.cone_sizes:
            begin = self.num_linear + np.cumsum([0, *self.cone_sizes])[:-1].astype(np.int64)
            squares = z[self.num_linear :] ** 2
            squares[begin - self.num_linear] = 0.0
            lengths = np.sqrt(np.add.reduceat(squares, begin - self.num_linear))
            z[begin] = np.maximum(z[begin], lengths * (1.0 + 1e-14))
        return z

    def solve(self, options: Any) -> Any:
        """Return Clarabel's answer."""
        cones = [
            clarabel.ZeroConeT(self.num_equal),
            clarabel.NonnegativeConeT(self.num_linear - self.num_equal),
            *(clarabel.SecondOrderConeT(size) for size in self.cone_sizes),
        ]
        return clarabel.DefaultSolver(self.P, self.q, self.A, self.b, cones, options).solve()

    def compute_least_violation(self, options: Any, lower: Array, upper: Array) -> float:
        """Return a lower bound on the violation of inequalities and cones; 0 if none is found.

        This program has an interior even where the node's has none, or is hardly infeasible.
        """
        heads = self.num_linear + np.cumsum([0, *self.cone_sizes])[:-1]
        slack = np.zeros((len(self.b), 1))
        first_bound = self.num_linear - self.num_bounds
        slack[self.num_equal : first_bound] = slack[heads.astype(np.int64)] = -1.0
        A = sparse.hstack([self.A, sparse.csc_matrix(slack)])
        nonnegative = sparse.csr_matrix(([-1.0], ([0], [A.shape[1] - 1])), shape=(1, A.shape[1]))
        rows, size, end = A.tocsr(), A.shape[1], self.num_linear
        elastic = _NodeProgram(
            P=sparse.csc_matrix((size, size)),
            q=np.append(np.zeros(size - 1), 1.0),
            A=sparse.vstack([rows[:end], nonnegative, rows[end:]]).tocsc(),
            b=np.insert(self.b, end, 0.0),
            num_equal=self.num_equal,
            num_linear=end + 1,
            num_bounds=self.num_bounds + 1,
            cone_sizes=self.cone_sizes,
        )
        answer = elastic.solve(options)
        low, high = np.append(lower, 0.0), np.append(upper, _LARGE)
        if answer.status == clarabel.SolverStatus.PrimalInfeasible:  # equations contradict bounds
            return np.inf if elastic.evaluate(np.array(answer.z), None, low, high) > 0.0 else 0.0
        return max(0.0, elastic.compute_bound(answer, low, high))


def _sum_columns(matrix: sparse.csc_matrix, entries: Array) -> tuple[Array, Array]:
    """Return the sums of entries of a matrix's sparsity by column, and of their sizes."""
    n = matrix.shape[1]
    column = np.repeat(np.arange(n), np.diff(matrix.indptr))
    return _add_up(column, entries, n), _add_up(column, np.abs(entries), n)


def _multiply_symmetric(upper: sparse.csc_matrix, x: Array) -> tuple[Array, Array]:
    """Return P x and |P| |x| from the upper triangle of P."""
    n = len(x)
    column = np.repeat(np.arange(n), np.diff(upper.indptr))
    mirrored = np.where(column == upper.indices, 0.0, upper.data)
    by_row, by_column = upper.data * x[column], mirrored * x[upper.indices]
    product = _add_up(upper.indices, by_row, n) + _add_up(column, by_column, n)
    size = _add_up(upper.indices, np.abs(by_row), n) + _add_up(column, np.abs(by_column), n)
    return product, size


def _add_up(places: IntArray, values: Array, n: int) -> Array:
    """Return (n,) the sums of values by place."""
    return np.bincount(places, values, n).astype(np.float64)


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
