"""Problems of CVXPY as programs: rows, second-order cones, integers, a convex quadratic cost.

CVXPY reduces a problem to

    minimise 1/2 x'P x + c'x + d  subject to  b - A x in a product of cones,

with x the problem's variables and those of its reductions (epigraphs, norms). Equations come first,
then nonnegative rows, then second-order cones s_0 >= ||s_1, s_2, ...||.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from cvxpy import settings
from cvxpy.constraints.nonpos import NonNeg
from cvxpy.constraints.second_order import SOC
from cvxpy.constraints.zero import Zero
from cvxpy.error import DCPError, SolverError
from cvxpy.problems.problem import Problem
from cvxpy.reductions.solvers.conic_solvers.conic_solver import ConicSolver
from cvxpy.reductions.solvers.solver import expand_cones
from scipy import sparse

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.affine_array import AffineArray, Quadratic
from climbplan.program.box import propagate_box
from climbplan.program.instance import Balls, Implications, Instance, Products

NAME = "CLIMBPLAN"


class ConicForm(ConicSolver):
    """The last reduction of CVXPY before a solver: numbers of rows, cones, integers and cost."""

    MIP_CAPABLE = True
    SUPPORTED_CONSTRAINTS = [Zero, NonNeg, SOC]  # type: ignore[list-item]  # noqa: RUF012
    MI_SUPPORTED_CONSTRAINTS = SUPPORTED_CONSTRAINTS

    def name(self) -> str:
        """Return the name under which CVXPY reports the solver."""
        return NAME

    def import_solver(self) -> None:
        """Import nothing: the solver is part of this package."""

    def supports_quad_obj(self) -> bool:
        """Return that quadratic costs need no cone."""
        return True

    def can_solve(self, problem_form: Any) -> bool:
        """Return that the problem has supported cones only.

        Raises:
            SolverError: It has others, which are named.
        """
        supported = frozenset(self.SUPPORTED_CONSTRAINTS)
        cones, _, _ = expand_cones(  # type: ignore[no-untyped-call]
            problem_form.cones(quad_obj=problem_form.has_quadratic_objective()).copy(), supported
        )
        if missing := sorted(cone.__name__ for cone in cones - supported):
            raise SolverError(
                f"{NAME} holds linear rows, quadratic costs and second-order cones; this problem "
                f"needs {', '.join(missing)}: state it without (exponentials, logarithms, "
                "semidefinite matrices), or use another solver"
            )
        return True

    def apply(self, problem: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the numbers of a problem, and what maps its solution back."""
        numbers, inverse = super().apply(problem)  # type: ignore[no-untyped-call]
        x = problem.x
        numbers[settings.BOOL_IDX] = [int(index[0]) for index in x.boolean_idx]
        numbers[settings.INT_IDX] = [int(index[0]) for index in x.integer_idx]
        numbers[settings.OFFSET] = inverse[settings.OFFSET]
        inverse["is_mip"] = bool(numbers[settings.BOOL_IDX] or numbers[settings.INT_IDX])
        return numbers, inverse

    def solve_via_data(
        self,
        data: dict[str, Any],
        warm_start: bool,
        verbose: bool,
        solver_opts: dict[str, Any],
        solver_cache: dict[str, Any] | None = None,
    ) -> Any:
        """Refuse to solve: this class only formulates.

        Raises:
            SolverError: Always.
        """
        raise SolverError("a ConicForm solves nothing: use climbplan.CVXPY()")

    def cite(self, data: Any) -> str:
        """Return nothing: the package states how to cite it."""
        return ""


def build_conic_instance(numbers: Mapping[str, Any], name: str) -> Instance:
    """Build the instance of CVXPY's numbers.

    Rows with one entry become bounds. A cone also states that its limit is nonnegative, which
    bounds variables that nothing else bounds.

    Args:
        numbers: What `ConicForm.apply` returns.
        name: Name of the instance.
    """
    dims = numbers[ConicSolver.DIMS]
    A, b = sparse.csr_matrix(numbers[settings.A]), np.asarray(numbers[settings.B], float)
    q = np.asarray(numbers[settings.C], float).ravel()
    n = len(q)
    P = numbers.get(settings.P)
    linear = dims.zero + dims.nonneg
    low = np.where(np.arange(linear) < dims.zero, b[:linear], -np.inf)
    balls = _build_cones(A, b, linear, dims.soc)
    rows, lower, upper = [A[:linear]], [low], [b[:linear]]
    for cones in balls:
        if cones.slope is not None:
            rows.append(-cones.slope)
            lower.append(np.full(cones.count, -np.inf))
            upper.append(cones.radius)
    integer = np.zeros(n, bool)
    integer[numbers[settings.BOOL_IDX] + numbers[settings.INT_IDX]] = True
    box_lower, box_upper = np.full(n, -np.inf), np.full(n, np.inf)
    box_lower[numbers[settings.BOOL_IDX]], box_upper[numbers[settings.BOOL_IDX]] = 0.0, 1.0
    matrix, row_lower, row_upper = _move_bounds(
        sparse.vstack(rows).tocsr(),
        np.concatenate(lower),
        np.concatenate(upper),
        box_lower,
        box_upper,
    )
    return Instance(
        name=name,
        P=sparse.csc_matrix((n, n) if P is None else P),
        q=q,
        constant=float(numbers[settings.OFFSET]),
        lower=box_lower,
        upper=box_upper,
        A=matrix,
        row_lower=row_lower,
        row_upper=row_upper,
        balls=balls,
        choices=(),
        integer=integer,
        products=Products(np.zeros(0, np.int64), np.zeros(0, np.int64)),
        Q=sparse.csr_matrix((matrix.shape[0], 0)),
        implications=_create_no_implications(n),
    )


def _create_no_implications(n: int) -> Implications:
    """Return implications without rows over n variables."""
    no_index, no_number = np.zeros(0, np.int64), np.zeros(0)
    no_rows, no_products = sparse.csr_matrix((0, n)), sparse.csr_matrix((0, 0))
    return Implications(no_rows, no_products, no_number, no_number, no_index, no_index > 0)


def state_cvxpy_problem(program: Any, problem: Any) -> None:
    """State a problem of CVXPY as a program: `Program.from_cvxpy`.

    Args:
        program: An empty `Program`, which states the problem afterwards.
        problem: A `cvxpy.Problem`. Its parameters count with their current values, and a
            maximisation is stated as the minimisation of the negated cost.

    Raises:
        UsageError: It is no problem, has no variables, is not convex, needs cones that are not of
            second order, has parameters without values, or integer variables without bounds or
            with bounds that cross.
    """
    if not isinstance(problem, Problem):
        raise UsageError(f"from_cvxpy: expected a cvxpy.Problem, got {type(problem).__name__}")
    if not problem.variables():
        raise UsageError("from_cvxpy: the problem has no variables")
    if unset := [p.name() for p in problem.parameters() if p.value is None]:
        raise UsageError(f"from_cvxpy: parameter {unset[0]!r} has no value: set one")
    try:
        numbers, chain, _ = problem.get_problem_data(ConicForm())
    except (SolverError, DCPError, ValueError) as error:
        raise UsageError(f"from_cvxpy: {error}") from error
    instance = build_conic_instance(numbers, "cvxpy")
    box = propagate_box(instance)
    lower = np.where(instance.integer, np.maximum(instance.lower, box.lower), instance.lower)
    upper = np.where(instance.integer, np.minimum(instance.upper, box.upper), instance.upper)
    instance = replace(instance, lower=lower, upper=upper)
    open_integers = instance.integer & ~(np.isfinite(instance.lower) & np.isfinite(instance.upper))
    names = _name_columns(problem, chain, numbers, instance.size)
    if (crossing := instance.lower > instance.upper).any():
        block = next(name for name, span in names.items() if crossing[span].any())
        raise UsageError(f"from_cvxpy: infeasible: the bounds of {block!r} cross")
    if open_integers.any():
        block = next(name for name, span in names.items() if open_integers[span].any())
        raise UsageError(f"from_cvxpy: integer variable {block!r} has no bounds: state them")
    for name, span in names.items():
        lower, upper = instance.lower[span], instance.upper[span]
        if instance.integer[span].any():
            program.integer(name, lower.shape, lower, upper)
        else:
            program.continuous(name, lower.shape, lower, upper)
    _state_rows(program, instance)


def _state_rows(program: Any, instance: Instance) -> None:
    """State rows, cones and cost over the variables of an instance."""
    rows = _as_affine(instance.A, np.zeros(instance.A.shape[0]))
    program.between("rows", rows, instance.row_lower, instance.row_upper)
    for k, balls in enumerate(instance.balls):
        vectors = AffineArray(
            balls.F, balls.f.ravel(), np.arange(balls.f.size).reshape(balls.f.shape)
        )
        if balls.slope is None:
            program.ball(f"balls{k}", vectors, balls.radius)
        else:
            program.cone(f"cones{k}", vectors, _as_affine(balls.slope, balls.radius))
    cost = Quadratic(sparse.csr_matrix(instance.P), instance.q, instance.constant)
    program.minimise("cost", cost)


def _as_affine(matrix: sparse.csr_matrix, constant: Array) -> AffineArray:
    """Return matrix x + constant as an array (m,)."""
    return AffineArray(sparse.csr_matrix(matrix), constant, np.arange(len(constant)))


def _name_columns(
    problem: Any, chain: Any, numbers: Mapping[str, Any], size: int
) -> dict[str, slice]:
    """Return blocks of columns of x: one for each variable of the problem, and those in between.

    Variables whose attributes CVXPY rewrites (symmetric, complex) are among the latter.
    """
    columns = numbers[settings.PARAM_PROB].var_id_to_col
    stated = {variable.id: variable for variable in problem.variables()}
    starts = sorted(
        (int(column), stated[key].name(), stated[key].size)
        for key, column in columns.items()
        if key in stated
    )
    integers = numbers[settings.BOOL_IDX] + numbers[settings.INT_IDX]
    cuts = sorted({0, size, *(int(c) for c in columns.values())} | {i + 1 for i in integers})
    names: dict[str, slice] = {}
    column = 0
    for start, name, count in [*starts, (size, "", 0)]:
        inner = [column, *(c for c in cuts if column < c < start), start]
        for begin, end in pairwise(inner):
            if end > begin:
                names[f"reduction{begin}"] = slice(begin, end)
        if count:
            names[name] = slice(start, start + count)
        column = start + count
    return names


def _build_cones(A: sparse.csr_matrix, b: Array, first: int, sizes: Any) -> tuple[Balls, ...]:
    """Build the cones by dimension; those whose limit is constant are balls."""
    groups: dict[tuple[int, bool], list[int]] = {}
    start = first
    for size in sizes:
        constant = A.indptr[start + 1] == A.indptr[start]
        groups.setdefault((int(size) - 1, bool(constant)), []).append(start)
        start += int(size)
    balls = []
    for (dimension, constant), starts in groups.items():
        heads = np.array(starts)
        members = (heads[:, None] + 1 + np.arange(dimension)).ravel()
        balls.append(
            Balls(
                F=sparse.csr_matrix(-A[members]),
                f=b[members].reshape(-1, dimension),
                radius=b[heads],
                slope=None if constant else sparse.csr_matrix(-A[heads]),
            )
        )
    return tuple(balls)


def _move_bounds(
    A: sparse.csr_matrix, lower: Array, upper: Array, box_lower: Array, box_upper: Array
) -> tuple[sparse.csr_matrix, Array, Array]:
    """Move rows with one entry into the box, which is changed; return the other rows."""
    A.eliminate_zeros()
    single = np.flatnonzero(np.diff(A.indptr) == 1)
    for i in single:
        j, a = A.indices[A.indptr[i]], A.data[A.indptr[i]]
        ends = sorted((lower[i] / a, upper[i] / a))
        box_lower[j], box_upper[j] = max(box_lower[j], ends[0]), min(box_upper[j], ends[1])
    is_row = np.diff(A.indptr) != 1
    return A[is_row], lower[is_row], upper[is_row]
