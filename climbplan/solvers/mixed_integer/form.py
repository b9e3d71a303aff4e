"""The program that nodes solve: 1/2 |v|^2 over rows, some of which only some nodes have.

Equations are eliminated (`elimination`), what is left is w = L'^-1 (v - u) with the Cholesky
factor L of the cost's Hessian (`cost`).

A binary that stands in conditional rows alone has no column (a switch, `pairs`); decided nodes have
its rows themselves. Other integers are columns, and their conditional rows are big-M rows while
they are undecided.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.linalg import solve_triangular

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.cost import Cost, ceiling, cost_over
from climbplan.solvers.mixed_integer.elimination import eliminated
from climbplan.solvers.mixed_integer.numbers import Impossible, MixedIntegerProgram, Numbers
from climbplan.solvers.mixed_integer.pairs import switches
from climbplan.solvers.mixed_integer.propagation import propagate
from climbplan.solvers.mixed_integer.row_stack import (
    Coordinates,
    RowStack,
    row_stack,
    with_products,
)
from climbplan.solvers.mixed_integer.spatial_rows import (
    Cells,
    Factors,
    no_products,
    spatial_numbers,
)

_ROUNDS = 20
_EQUAL = 1e-12  # sides of an equation, relative
_FEASIBLE = 1e-9  # tolerance of rows in their own unit, as far as rounding allows


def mixed_integer_program(
    instance: Instance,
    form: Conditional,
    deadline: float = np.inf,
    factors: Factors | None = None,
) -> MixedIntegerProgram | Impossible | None:
    """Build all rows of an instance's conditional form; None where the deadline comes first.

    deadline: of `time.perf_counter` [s], which is looked at between the parts of the work.
    factors: of products, where the instance is one that is linear in them.
    Raises UsageError where a direction without cost is not bounded.
    """
    box = _presolved(form)
    if box is None:
        return Impossible("bounds cross when they are propagated")
    space = _coordinates(instance, form, factors, *box)
    if space is None:
        return Impossible("equations contradict each other")
    if time.perf_counter() >= deadline:
        return None
    cost = cost_over(instance, space)
    if time.perf_counter() >= deadline:
        return None
    stack = row_stack(form, space)
    if stack is None:
        return Impossible("a row cannot hold within the bounds")
    if time.perf_counter() >= deadline:
        return None
    return _in_unit_rows(instance, form, space, cost, stack, factors)


def equations(lower: Array, upper: Array) -> BoolArray:
    """(m,) which rows have the same bound on both sides."""
    return np.isfinite(upper) & (upper - lower <= _EQUAL * np.maximum(1.0, np.abs(upper)))


def _presolved(form: Conditional) -> tuple[Array, Array] | None:
    """The box that bounds and rows leave, None if it is empty."""
    lower, upper = form.lower.astype(float), form.upper.astype(float)
    whole = form.integer
    lower[whole], upper[whole] = np.ceil(lower[whole] - 1e-9), np.floor(upper[whole] + 1e-9)
    A, C = form.A, form.C
    possible = bool((lower <= upper).all()) and propagate(
        A.indptr, A.indices, A.data, form.row_lower, form.row_upper,
        C.indptr, C.indices, C.data, form.when_lower, form.when_upper, form.when, form.value,
        form.integer, lower, upper, _ROUNDS,
    )  # fmt: skip
    return (lower, upper) if possible else None


def _coordinates(
    instance: Instance,
    form: Conditional,
    factors: Factors | None,
    lower: Array,
    upper: Array,
) -> Coordinates | None:
    """Equations, and integers that bounds have decided, solved for; None if they contradict."""
    switch = switches(instance, form)
    if factors is not None:
        switch[factors.products.first] = switch[factors.products.second] = False
    equal = equations(form.row_lower, form.row_upper)
    fixed = np.flatnonzero((upper - lower <= 0.0) & form.integer & ~switch)
    columns = np.flatnonzero(~switch)
    place = np.full(form.size, -1)
    place[columns] = np.arange(len(columns))
    dense = form.A.toarray()
    E = np.zeros((int(equal.sum()) + len(fixed), len(columns)))
    E[len(fixed) :] = dense[equal][:, columns]
    E[np.arange(len(fixed)), place[fixed]] = 1.0
    e = np.concatenate([lower[fixed], form.row_upper[equal]])
    solved = eliminated(E, e, form.integer[columns])
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


def _in_unit_rows(
    instance: Instance,
    form: Conditional,
    space: Coordinates,
    cost: Cost,
    stack: RowStack,
    factors: Factors | None,
) -> MixedIntegerProgram:
    """Rows over v, of unit length, and what nodes do not change of them."""
    k = space.X.shape[1]
    entities = np.flatnonzero(form.integer)
    stated = len(stack.R)
    if factors is not None:
        stack = with_products(stack, form, factors, space)
    M = solve_triangular(cost.L, stack.R.T, lower=True).T if k else stack.R
    norm = np.linalg.norm(M, axis=1)
    norm = np.where(norm > 0.0, norm, 1.0)  # a factor that equations leave one value
    M = np.ascontiguousarray(M / norm[:, None])
    at = -(M @ cost.u)  # value at v = 0, by unit of v
    low, high = space.lower[space.independent], space.upper[space.independent]
    ball_rows, ball, radius = _balls(instance, space.X, space.start)
    number = np.full(form.size, -1)
    number[entities] = np.arange(len(entities))
    lowest, highest = space.lower[entities], space.upper[entities]
    spatial = no_products(len(entities), k)
    if factors is not None:
        number[factors.space] = len(entities) + np.arange(len(factors.space))
        cells = Cells.of(space.lower[factors.space], space.upper[factors.space])
        over_v = solve_triangular(cost.L, space.X.T, lower=True).T if k else space.X
        spatial = spatial_numbers(
            factors, number, len(entities), cells, space.start, over_v, stated
        )
        lowest = np.concatenate([lowest, np.zeros(len(cells.count))])
        highest = np.concatenate([highest, cells.count - 1.0])
    numbers = Numbers(
        lower=stack.low / norm - at,
        upper=stack.high / norm - at,
        norm=norm,
        offset=at * norm + stack.base,
        when=stack.when,
        entity=stack.entity.astype(np.int64),
        value=stack.value.astype(np.int64),
        share=stack.share,
        column=stack.column.astype(np.int64),
        first=stack.first.astype(np.int64),
        rows_of=stack.rows_of.astype(np.int64),
        group=_groups(form, number).astype(np.int64),
        lowest=lowest.astype(np.int64),
        highest=highest.astype(np.int64),
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
        ceiling=ceiling(cost.H, cost.g, cost.constant, low, high),
        ball_rows=ball_rows,
        ball=ball,
        radius=radius,
        spatial=spatial,
    )
    return MixedIntegerProgram(
        numbers=numbers,
        M=M,
        T=np.ascontiguousarray(M.T),
        tolerance=np.maximum(_FEASIBLE / norm, 1e-13),
        X=space.X,
        start=space.start,
        entities=entities,
        factors=np.zeros(0, np.int64) if factors is None else factors.space,
        products=form.size if factors is None else int(factors.places[0]),
        key=stack.key,
        lower=space.lower,
        upper=space.upper,
        independent=space.independent,
    )


def _balls(instance: Instance, X: Array, start: Array) -> tuple[Array, Array, Array]:
    """All balls over w: rows (B, D, k), centres (B, D), radii (B,)."""
    n, k = instance.size, X.shape[1]
    count = sum(balls.count for balls in instance.balls)
    width = max((balls.f.shape[1] for balls in instance.balls if balls.count), default=0)
    rows, centre, radius = np.zeros((count, width, k)), np.zeros((count, width)), np.zeros(count)
    at = 0
    for balls in instance.balls:
        here, d = slice(at, at + balls.count), balls.f.shape[1]
        rows[here, :d] = (balls.F @ X[:n]).reshape(balls.count, d, k)
        centre[here, :d] = balls.vectors(start[:n])
        radius[here] = balls.radius
        at += balls.count
    return rows, centre, radius


def _groups(form: Conditional, number: IntArray) -> IntArray:
    """Exactly-one group of each integer: rows that add binaries up to one."""
    group = np.full(int((number >= 0).sum()), -1)
    A = form.A
    for r in np.flatnonzero((form.row_lower == 1.0) & (form.row_upper == 1.0)):
        here = slice(A.indptr[r], A.indptr[r + 1])
        members = A.indices[here]
        if (A.data[here] == 1.0).all() and form.integer[members].all():
            group[number[members]] = r
    return group
