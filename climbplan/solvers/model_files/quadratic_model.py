"""A mixed-integer program with quadratic cost and rows, as model files state it.

    minimise 1/2 x'P x + q'x + c  subject to  l_i <= a_i'x + 1/2 x'H_i x <= u_i, bounds, integers.

Convex quadratic rows become second-order cones or balls, others rows with products of variables. A
cost that is not convex is shifted along binaries, whose squares are linear, or it becomes the
variable `cost` with a row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError
from climbplan.program.affine_array import AffineArray, Quadratic
from climbplan.program.box import compute_product_range, propagate_box
from climbplan.program.instance import Implications, Instance, Products
from climbplan.program.statement import Program
from climbplan.solvers.separable_cost import factor_cost

MAX_VARIABLES = 20_000
MAX_ROWS = 100_000
MAX_BYTES = 100_000_000
_CONVEX = 1e-10  # least eigenvalue of a convex matrix, relative to the largest
_MAX_DENSE = 3_000  # variables in one quadratic form, whose eigenvalues are computed
_COST = "cost"


@dataclass(frozen=True)
class QuadraticModel:
    """The numbers of a model file; those of a maximisation are stored as stated."""

    name: str
    variables: tuple[str, ...]
    lower: Array  # (n,)
    upper: Array  # (n,)
    integer: BoolArray  # (n,)
    P: sparse.csr_matrix  # (n, n) symmetric
    q: Array  # (n,)
    constant: float
    maximise: bool
    rows: tuple[str, ...]
    A: sparse.csr_matrix  # (m, n)
    row_lower: Array  # (m,)
    row_upper: Array  # (m,)
    curvature: Mapping[int, sparse.csr_matrix]  # row -> symmetric H (n, n)

    @property
    def size(self) -> int:
        """Number of variables n."""
        return len(self.q)


def state_model(model: QuadraticModel) -> Program:
    """State a model as a program: one block for each variable and each quadratic row.

    Linear rows are the block `rows`. The cost of a maximisation is negated.

    Args:
        model: The model.

    Raises:
        UsageError: Bounds or ends of rows cross or are NaN, or an integer variable has no bounds
            and none follow from the rows.
    """
    _check_ranges(model)
    program = Program(model.name)
    lower, upper = _bound_integers(model)
    symbols: list[Any] = []
    for name, low, high, integer in zip(model.variables, lower, upper, model.integer, strict=True):
        state = program.integer if integer else program.continuous
        symbols += state(name, (1,), low, high).tolist()
    sign = -1.0 if model.maximise else 1.0
    cost = Quadratic(sign * model.P, sign * model.q, sign * model.constant)
    binary = model.integer & (lower >= 0.0) & (upper <= 1.0)
    convex = _make_convex(cost, binary)
    if convex is None:
        low, high = _compute_range(cost, lower, upper)
        symbols += program.continuous(_name_cost(model), (1,), low, high).tolist()
    linear = np.array([i not in model.curvature for i in range(len(model.rows))], bool)
    if linear.any():
        rows = _build_affine(model.A[linear], np.zeros(int(linear.sum())), len(symbols))
        program.between("rows", rows, model.row_lower[linear], model.row_upper[linear])
    for row, H in sorted(model.curvature.items()):
        _state_quadratic_row(program, model, row, H, binary, symbols)
    if convex is not None:
        program.minimise(_COST, convex)
    else:
        terms = _expand(cost.P, cost.q, binary, symbols)
        program.between("cost row", np.array([terms - symbols[-1]]), -np.inf, -cost.constant)
        program.minimise(_COST, symbols[-1])
    return program


def _check_ranges(model: QuadraticModel) -> None:
    """Check that bounds and ends of rows are ordered.

    Raises:
        UsageError: They are not, or one is NaN.
    """
    for what, names, low, high in (
        ("variable", model.variables, model.lower, model.upper),
        ("row", model.rows, model.row_lower, model.row_upper),
    ):
        if (wrong := ~(low <= high)).any():
            i = int(wrong.argmax())
            raise UsageError(
                f"{model.name}: {what} {names[i]!r}: lower <= upper expected, got {low[i]:g} and "
                f"{high[i]:g}"
            )


def _name_cost(model: QuadraticModel) -> str:
    """Return a name for the variable of the cost that no other variable has."""
    name = _COST
    while name in model.variables:
        name += "_"
    return name


def _bound_integers(model: QuadraticModel) -> tuple[Array, Array]:
    """Return the bounds, those of integers rounded and tightened by linear rows where infinite.

    Raises:
        UsageError: An integer variable stays without bounds.
    """
    integer = model.integer
    lower = np.where(integer, np.ceil(model.lower - 1e-9), model.lower)
    upper = np.where(integer, np.floor(model.upper + 1e-9), model.upper)
    is_open = integer & ~(np.isfinite(lower) & np.isfinite(upper))
    if is_open.any():
        box = propagate_box(build_linear_instance(model))
        lower[is_open] = np.maximum(lower, box.lower)[is_open]
        upper[is_open] = np.minimum(upper, box.upper)[is_open]
    for i in np.flatnonzero(integer):
        if not np.isfinite([lower[i], upper[i]]).all():
            raise UsageError(
                f"{model.name}: integer variable {model.variables[i]!r} has no bounds, and none "
                "follow from linear rows: state them"
            )
        if lower[i] > upper[i]:
            raise UsageError(f"{model.name}: variable {model.variables[i]!r} has no integer value")
    return lower, upper


def build_linear_instance(model: QuadraticModel) -> Instance:
    """Return the instance of bounds, integers and linear rows, without the cost."""
    linear = np.array([i not in model.curvature for i in range(len(model.rows))], bool)
    A = sparse.csr_matrix(model.A[linear])
    no_index, no_number, n = np.zeros(0, np.int64), np.zeros(0), model.size
    return Instance(
        name=model.name,
        P=sparse.csc_matrix((n, n)),
        q=np.zeros(n),
        constant=0.0,
        lower=model.lower,
        upper=model.upper,
        A=A,
        row_lower=model.row_lower[linear],
        row_upper=model.row_upper[linear],
        balls=(),
        choices=(),
        integer=model.integer,
        products=Products(no_index, no_index),
        Q=sparse.csr_matrix((A.shape[0], 0)),
        implications=Implications(
            sparse.csr_matrix((0, n)),
            sparse.csr_matrix((0, 0)),
            no_number,
            no_number,
            no_index,
            no_index > 0,
        ),
    )


def _make_convex(cost: Quadratic, binary: BoolArray) -> Quadratic | None:
    """Return a convex cost that is the same at all binaries; None where there is none.

    The square of a binary is the binary itself, so d (x^2 - x) may be added to the cost.
    """
    smallest = compute_least_eigenvalue(cost.P)
    if smallest >= 0.0:
        return cost
    shift = np.where(binary & (np.diff(cost.P.indptr) > 0), -smallest, 0.0)
    shifted = sparse.csr_matrix(cost.P + sparse.diags(shift))
    if compute_least_eigenvalue(shifted) < 0.0:
        return None
    return Quadratic(shifted, cost.q - 0.5 * shift, cost.constant)


def compute_least_eigenvalue(H: sparse.csr_matrix) -> float:
    """Return the least eigenvalue of a symmetric matrix; 0 where rounding alone makes it negative.

    Raises:
        UsageError: The matrix is too large.
    """
    index = np.flatnonzero(np.diff(H.indptr))
    if len(index) > _MAX_DENSE:
        raise UsageError(
            f"a quadratic form over {len(index)} variables: {_MAX_DENSE} at most expected"
        )
    if not len(index):
        return 0.0
    values = np.linalg.eigvalsh(H[index][:, index].toarray())
    is_rounding = values[0] >= -_CONVEX * max(values[-1], 0.0)
    return 0.0 if is_rounding else float(values[0]) * (1.0 + 1e-9) - 1e-12


def _compute_range(cost: Quadratic, lower: Array, upper: Array) -> tuple[float, float]:
    """Return bounds of a cost over a box; infinite where an entry is."""
    P = sparse.triu(cost.P).tocoo()
    products = compute_product_range(lower, upper, P.row, P.col)
    weights = np.append(np.where(P.row == P.col, 0.5, 1.0) * P.data, cost.q)
    ends = np.stack([np.append(products.lower, lower), np.append(products.upper, upper)])[
        :, weights != 0.0
    ]
    terms = weights[weights != 0.0] * ends
    low, high = terms.min(axis=0).sum(), terms.max(axis=0).sum()
    return float(cost.constant + low), float(cost.constant + high)


def _build_affine(matrix: sparse.csr_matrix, constant: Array, size: int) -> AffineArray:
    """Return matrix x + constant, (m,), over `size` variables."""
    wide = sparse.csr_matrix(
        (matrix.data, matrix.indices, matrix.indptr), shape=(matrix.shape[0], size)
    )
    return AffineArray(wide, constant, np.arange(len(constant)))


def _state_quadratic_row(
    program: Program,
    model: QuadraticModel,
    row: int,
    H: sparse.csr_matrix,
    binary: BoolArray,
    symbols: list[Any],
) -> None:
    """State one row: a cone where it is convex, else products."""
    name, a = model.rows[row], model.A[row].toarray().ravel()
    low, high = float(model.row_lower[row]), float(model.row_upper[row])
    for sign, end in ((1.0, high), (-1.0, -low)):
        if not np.isfinite(end):
            continue
        convex = _make_convex(Quadratic(sparse.csr_matrix(sign * H), sign * a, -end), binary)
        if convex is None:
            terms = _expand(sparse.csr_matrix(sign * H), sign * a, binary, symbols)
            program.between(f"{name} (q)", np.array([terms]), -np.inf, end)
            continue
        _state_cone(program, f"{name} (cone)", convex, len(symbols))


def _state_cone(program: Program, name: str, row: Quadratic, size: int) -> None:
    """State 1/2 x'H x + a'x + c <= 0 with convex H.

    With 1/2 |u|^2 + s'x + d for the left side it is |u|^2 <= 2 t with t = -s'x - d, which is the
    cone |(u, t - 1/2)| <= t + 1/2, or a ball where s is 0.
    """
    n = len(row.q)
    squares = factor_cost(
        replace(
            _create_free_instance(n),
            P=sparse.csc_matrix(row.P),
            q=row.q,
            constant=row.constant,
        )
    )
    if not np.abs(squares.slope).max(initial=0.0) and squares.constant <= 0.0:
        vectors = _build_affine(squares.U, squares.offset, size)
        program.ball(name, _as_vectors(vectors), np.array([np.sqrt(-2.0 * squares.constant)]))
        return
    slope = sparse.csr_matrix(-squares.slope)
    stacked = _build_affine(
        sparse.vstack([squares.U, slope]).tocsr(),
        np.append(squares.offset, -squares.constant - 0.5),
        size,
    )
    limit = _build_affine(slope, np.array([0.5 - squares.constant]), size)
    program.cone(name, _as_vectors(stacked), limit)


def _as_vectors(entries: AffineArray) -> AffineArray:
    """Return entries (d,) as one vector (1, d)."""
    return entries[np.arange(len(entries))[None]]


def _create_free_instance(n: int) -> Instance:
    """Return an instance of n variables without rows and bounds."""
    free = np.full(n, np.inf)
    return build_linear_instance(
        QuadraticModel(
            name="",
            variables=(),
            lower=-free,
            upper=free,
            integer=np.zeros(n, bool),
            P=sparse.csr_matrix((n, n)),
            q=np.zeros(n),
            constant=0.0,
            maximise=False,
            rows=(),
            A=sparse.csr_matrix((0, n)),
            row_lower=np.zeros(0),
            row_upper=np.zeros(0),
            curvature={},
        )
    )


def _expand(H: sparse.csr_matrix, a: Array, binary: BoolArray, symbols: list[Any]) -> Any:
    """Return 1/2 x'H x + a'x as a scalar; squares of binaries are linear."""
    total: Any = sum((a[j] * symbols[j] for j in np.flatnonzero(a)), 0.0 * symbols[0])
    upper = sparse.triu(H).tocoo()
    for i, j, value in zip(upper.row, upper.col, upper.data, strict=True):
        if i == j:
            square = symbols[i] if binary[i] else symbols[i] * symbols[i]
            total = total + 0.5 * value * square
        else:
            total = total + value * symbols[i] * symbols[j]
    return total
