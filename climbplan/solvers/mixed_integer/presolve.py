"""Presolve an instance and build the program that nodes solve: 1/2 |v|^2 over rows.

Equations are eliminated (`elimination`). The remaining variables are w = L'^-1 (v - u) with the
Cholesky factor L of the cost's Hessian (`cost`).

A binary that occurs in indicator rows only has no column (a switch, see `switch_pairs`): its rows
are active once it is fixed. Other integers are columns, and their indicator rows are big-M rows
while they are undecided.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.cost import Cost, build_cost, compute_max_cost
from climbplan.solvers.mixed_integer.elimination import eliminate_equations
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.problem_data import (
    MixedIntegerProgram,
    ProblemData,
    ProvedInfeasible,
)
from climbplan.solvers.mixed_integer.product_data import (
    Cells,
    ProductFactors,
    build_spatial,
    empty_spatial,
)
from climbplan.solvers.mixed_integer.propagation import SparseRows, propagate_bounds
from climbplan.solvers.mixed_integer.row_stack import (
    Coordinates,
    NodeRows,
    append_products,
    stack_rows,
)
from climbplan.solvers.mixed_integer.spatial import Spatial
from climbplan.solvers.mixed_integer.switch_pairs import find_switches
from climbplan.solvers.result import compute_zero_cost

_ROUNDS = 20
_EQUAL = 1e-12  # relative difference of the sides of an equation
_FEASIBLE = 1e-9  # tolerance of stated rows, as far as rounding allows


def build_mixed_integer_program(
    instance: Instance,
    form: IndicatorForm,
    deadline: float = np.inf,
    factors: ProductFactors | None = None,
    by_gradient: bool = False,
) -> MixedIntegerProgram | ProvedInfeasible | None:
    """Build the program of an instance's indicator form; None where the deadline comes first.

    Args:
        instance: The instance, linear in products where it has any.
        form: Its indicator form.
        deadline: Time of `time.perf_counter` [s], checked between the steps.
        factors: Factors of products, where there are any.
        by_gradient: Whether the linear cost, too, sets the size of the proximal term.

    Raises:
        UsageError: A direction without cost is not bounded.
    """
    box = _propagate_box(form)
    if box is None:
        return ProvedInfeasible("bounds cross when they are propagated")
    space = _eliminate_variables(instance, form, factors, *box)
    if space is None:
        return ProvedInfeasible("equations contradict each other")
    if time.perf_counter() >= deadline:
        return None
    cost = build_cost(instance, space, by_gradient)
    if time.perf_counter() >= deadline:
        return None
    stack = stack_rows(form, space)
    if stack is None:
        return ProvedInfeasible("a row cannot hold within the bounds")
    if time.perf_counter() >= deadline:
        return None
    return _assemble_program(instance, form, space, cost, stack, factors)


def find_equations(lower: Array, upper: Array) -> BoolArray:
    """Return (m,) mask of rows with the same bound on both sides."""
    return np.isfinite(upper) & (upper - lower <= _EQUAL * np.maximum(1.0, np.abs(upper)))


def _propagate_box(form: IndicatorForm) -> tuple[Array, Array] | None:
    """Return the box after bound propagation, or None if it is empty."""
    lower, upper = form.lower.astype(float), form.upper.astype(float)
    integer = form.integer
    lower[integer], upper[integer] = np.ceil(lower[integer] - 1e-9), np.floor(upper[integer] + 1e-9)
    A, C = form.A, form.C
    plain = SparseRows(A.indptr, A.indices, A.data, form.row_lower, form.row_upper)
    conditional = SparseRows(
        C.indptr, C.indices, C.data, form.indicator_lower, form.indicator_upper
    )
    possible = bool((lower <= upper).all()) and propagate_bounds(
        plain, conditional, form.indicator, form.value, form.integer, lower, upper, _ROUNDS
    )
    return (lower, upper) if possible else None


def _eliminate_variables(
    instance: Instance,
    form: IndicatorForm,
    factors: ProductFactors | None,
    lower: Array,
    upper: Array,
) -> Coordinates | None:
    """Eliminate equations and fixed integers; None if they contradict each other."""
    switch = find_switches(instance, form)
    if factors is not None:
        switch[factors.products.first] = switch[factors.products.second] = False
    equal = find_equations(form.row_lower, form.row_upper)
    fixed = np.flatnonzero((upper - lower <= 0.0) & form.integer & ~switch)
    columns = np.flatnonzero(~switch)
    place = np.full(form.size, -1)
    place[columns] = np.arange(len(columns))
    dense = form.A.toarray()
    E = np.zeros((int(equal.sum()) + len(fixed), len(columns)))
    E[len(fixed) :] = dense[equal][:, columns]
    E[np.arange(len(fixed)), place[fixed]] = 1.0
    e = np.concatenate([lower[fixed], form.row_upper[equal]])
    solved = eliminate_equations(E, e, form.integer[columns])
    if not solved.consistent:
        return None
    k = len(solved.independent)
    X, start = np.zeros((form.size, k)), np.zeros(form.size)
    X[columns], start[columns] = solved.X, solved.center
    return Coordinates(
        X=X,
        start=start,
        lower=lower,
        upper=upper,
        switch=switch,
        equal=equal,
        columns=columns,
        independent=columns[solved.independent],
        inside=place[columns[solved.independent]],
    )


class _Entities(NamedTuple):
    """Integers, then factors of products: their ranges at the root, and data of the products."""

    entity_of: IntArray  # (size,) entity of each variable, -1 for none
    root_low: Array  # (E,)
    root_high: Array  # (E,)
    spatial: Spatial


def _number_entities(
    form: IndicatorForm,
    space: Coordinates,
    cost: Cost,
    factors: ProductFactors | None,
    num_stated: int,
) -> _Entities:
    """Number integers and factors; products have their rows after the `num_stated` stated ones."""
    entities = np.flatnonzero(form.integer)
    entity_of = np.full(form.size, -1)
    entity_of[entities] = np.arange(len(entities))
    root_low, root_high = space.lower[entities], space.upper[entities]
    if factors is None:
        spatial = empty_spatial(len(entities), space.X.shape[1])
        return _Entities(entity_of, root_low, root_high, spatial)
    entity_of[factors.space] = len(entities) + np.arange(len(factors.space))
    cells = Cells.divide(space.lower[factors.space], space.upper[factors.space])
    spatial = build_spatial(
        factors,
        cells,
        entity_of=entity_of,
        num_integers=len(entities),
        start=space.start,
        over_v=_express_over_v(cost, space.X),
        num_stated=num_stated,
    )
    return _Entities(
        entity_of,
        np.concatenate([root_low, np.zeros(len(cells.count))]),
        np.concatenate([root_high, cells.count - 1.0]),
        spatial,
    )


def _express_over_v(cost: Cost, R: Array) -> Array:
    """Return the coefficients over v of rows (m, k) over w."""
    return solve_triangular(cost.L, R.T, lower=True).T if R.shape[1] else R


def _scale_rows(R: Array) -> tuple[Array, Array]:
    """Scale rows (m, k) to unit length; return them and their lengths (m,)."""
    norm = np.linalg.norm(R, axis=1)
    norm = np.where(norm > 0.0, norm, 1.0)  # a factor that equations leave one value
    return np.ascontiguousarray(R / norm[:, None]), norm


def _assemble_program(
    instance: Instance,
    form: IndicatorForm,
    space: Coordinates,
    cost: Cost,
    stack: NodeRows,
    factors: ProductFactors | None,
) -> MixedIntegerProgram:
    """Assemble the problem data over v from rows over w."""
    numbering = _number_entities(form, space, cost, factors, len(stack.R))
    stack = stack if factors is None else append_products(stack, form, factors, space)
    M, norm = _scale_rows(_express_over_v(cost, stack.R))
    value_at_u = -(M @ cost.u)  # value at v = 0, by unit of v
    low, high = space.lower[space.independent], space.upper[space.independent]
    numbers = ProblemData(
        lower=stack.low / norm - value_at_u,
        upper=stack.high / norm - value_at_u,
        norm=norm,
        offset=value_at_u * norm + stack.base,
        activation=stack.activation,
        entity=stack.entity.astype(np.int64),
        value=stack.value.astype(np.int64),
        inverse_big_m=stack.inverse_big_m,
        value_row=stack.value_row.astype(np.int64),
        indicator_start=stack.indicator_start.astype(np.int64),
        indicator_rows=stack.indicator_rows.astype(np.int64),
        group=_find_groups(form, numbering.entity_of).astype(np.int64),
        root_low=numbering.root_low.astype(np.int64),
        root_high=numbering.root_high.astype(np.int64),
        L=np.ascontiguousarray(cost.L),
        U=np.ascontiguousarray(cost.L.T),
        u=cost.u,
        eps=cost.eps,
        center=cost.center,
        box_lower=low,
        box_upper=high,
        H=np.ascontiguousarray(cost.H),
        g=cost.g,
        constant=cost.constant,
        max_cost=compute_max_cost(cost.H, cost.g, cost.constant, low, high),
        **_build_balls(instance, space.X, space.start),
        spatial=numbering.spatial,
    )
    return MixedIntegerProgram(
        data=numbers,
        M=M,
        T=np.ascontiguousarray(M.T),
        tolerance=np.maximum(_FEASIBLE / norm, 1e-13),
        X=space.X,
        start=space.start,
        entities=np.flatnonzero(form.integer),
        factors=np.zeros(0, np.int64) if factors is None else factors.space,
        products=form.size if factors is None else int(factors.places[0]),
        row_key=stack.key,
        lower=space.lower,
        upper=space.upper,
        independent=space.independent,
        zero_cost=compute_zero_cost(instance),
    )


def _build_balls(instance: Instance, X: Array, start: Array) -> dict[str, Array]:
    """Return all balls over w: rows (B, D, k), centers (B, D), radii (B,) and slopes (B, k).

    The keys are the fields of `ProblemData`.
    """
    n, k = instance.size, X.shape[1]
    count = sum(balls.count for balls in instance.balls)
    width = max((balls.f.shape[1] for balls in instance.balls if balls.count), default=0)
    rows, center, radius = np.zeros((count, width, k)), np.zeros((count, width)), np.zeros(count)
    slope = np.zeros((count, k))
    begin = 0
    for balls in instance.balls:
        span, d = slice(begin, begin + balls.count), balls.f.shape[1]
        rows[span, :d] = (balls.F @ X[:n]).reshape(balls.count, d, k)
        center[span, :d] = balls.vectors(start[:n])
        radius[span] = balls.limits(start[:n])
        if balls.slope is not None:
            slope[span] = balls.slope @ X[:n]
        begin += balls.count
    return {"ball_rows": rows, "ball": center, "radius": radius, "slope": slope}


def _find_groups(form: IndicatorForm, number: IntArray) -> IntArray:
    """Return the exactly-one group of each integer: rows that sum binaries to one."""
    group = np.full(int((number >= 0).sum()), -1)
    A = form.A
    for r in np.flatnonzero((form.row_lower == 1.0) & (form.row_upper == 1.0)):
        span = slice(A.indptr[r], A.indptr[r + 1])
        members = A.indices[span]
        if (A.data[span] == 1.0).all() and form.integer[members].all():
            group[number[members]] = r
    return group
