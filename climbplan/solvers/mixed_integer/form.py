"""The program that nodes solve: 1/2 |v|^2 over rows, some of which only some nodes have.

Equations are eliminated (`elimination`), what is left is w = L'^-1 (v - u) with the Cholesky
factor L of the cost's Hessian. A small proximal term makes that definite: 1/2 sum eps_i (w_i -
center_i)^2, whose effect on a bound is subtracted exactly (`search`), which needs a bound on
every w_i that the cost leaves flat.

A binary that stands in conditional rows alone has no column (a switch). With a_i x <= b_i where
it is 1, c_j x <= d_j where it is 0, and M_i, N_j the most by which these fail over the box,
undecided nodes have (a_i x - b_i) / M_i + (c_j x - d_j) / N_j <= 1, which is what big-M rows say
of x; decided ones have the rows themselves. Other integers are columns, and their conditional
rows are big-M rows while they are undecided.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.elimination import eliminated
from climbplan.solvers.mixed_integer.keys import KeySpace
from climbplan.solvers.mixed_integer.propagation import interval, propagate
from climbplan.solvers.result import Indices

ALWAYS, DECIDED, UNDECIDED = 0, 1, 2  # when a node has a row
_PROXIMAL = 1e-6  # of the cost's own curvature over the box
_FLAT = 1e-11  # pivot of the Hessian below which a direction is flat, relative
_ROUNDS = 20
_PAIRS = 4  # times as many pairs as rows: a binary with more keeps its column
_EQUAL = 1e-12  # sides of an equation, relative
_SLACK = 1e-9
_FEASIBLE = 1e-9  # tolerance of rows in their own unit, as far as rounding allows


class Numbers(NamedTuple):
    """Everything about the rows and integers that nodes do not change."""

    lower: Array  # (m,) of unit rows in v, at the centre of the beginning
    upper: Array
    norm: Array  # (m,) own unit by unit of v
    offset: Array  # (m,) value in the own unit at v = 0
    when: NDArray[np.int8]  # (m,) ALWAYS, DECIDED, UNDECIDED
    entity: NDArray[np.int64]  # (m,) integer that decides, -1
    value: NDArray[np.int64]  # (m,) of a decided integer that has the row
    share: Array  # (m,) of DECIDED rows: 1 / M, which makes violations comparable
    column: NDArray[np.int64]  # (E,) row that holds an integer's value, -1 for a switch
    first: NDArray[np.int64]  # (E + 1,) where in `rows_of` the conditional rows of an integer stand
    rows_of: NDArray[np.int64]
    group: NDArray[np.int64]  # (E,) exactly-one group, -1
    lowest: NDArray[np.int64]  # (E,) root's bounds
    highest: NDArray[np.int64]
    L: Array  # (k, k)
    U: Array  # (k, k) L'
    u: Array  # (k,)
    eps: Array  # (k,)
    center: Array  # (k,)
    box_lower: Array  # (k,) of w
    box_upper: Array
    H: Array  # (k, k)
    g: Array  # (k,)
    constant: float
    ceiling: float  # no point of the box costs more
    ball_rows: Array  # (B, D, k) |ball_rows w + ball| <= radius, zeros where a ball has fewer rows
    ball: Array  # (B, D)
    radius: Array  # (B,)


@dataclass(frozen=True)
class MixedIntegerProgram:
    """What a search works on, and the way back."""

    numbers: Numbers
    M: Array  # (m, k) unit rows
    T: Array  # (k, m)
    tolerance: Array  # (m,)
    X: Array  # (size, k) x = X w + start
    start: Array  # (size,)
    entities: Indices  # (E,) the integers' places in x
    key: NDArray[np.int64]  # (m,) what each row is, whatever the parameters: see `memory`
    lower: Array  # (size,) the box that bounds and rows leave
    upper: Array
    independent: Indices  # (k,) places of w in x

    @property
    def size(self) -> int:
        """k."""
        return self.M.shape[1]

    def point(self, w: Array, low: NDArray[np.int64]) -> Array:
        """x (size,) at w with integers at `low` (E,)."""
        x = self.X @ w + self.start
        x[self.entities] = low
        return x


def with_room(numbers: Numbers, by: int) -> Numbers:
    """The same numbers with room for further rows."""
    if not by:
        return numbers
    names = ("lower", "upper", "norm", "offset", "when", "entity", "value", "share")
    parts: dict[str, Any] = {name: getattr(numbers, name) for name in names}
    parts = {name: np.concatenate([p, np.zeros(by, p.dtype)]) for name, p in parts.items()}
    return numbers._replace(**parts)


@dataclass(frozen=True)
class Impossible:
    """Why nothing is feasible, found before any search."""

    why: str


def mixed_integer_program(
    instance: Instance, form: Conditional
) -> MixedIntegerProgram | Impossible:
    """Build all rows of an instance's conditional form.

    Raises UsageError where a direction without cost is not bounded.
    """
    lower, upper = form.lower.astype(float), form.upper.astype(float)
    lower[form.integer], upper[form.integer] = (
        np.ceil(lower[form.integer] - 1e-9),
        np.floor(upper[form.integer] + 1e-9),
    )
    A, C = form.A, form.C
    possible = bool((lower <= upper).all()) and propagate(
        A.indptr, A.indices, A.data, form.row_lower, form.row_upper,
        C.indptr, C.indices, C.data, form.when_lower, form.when_upper, form.when, form.value,
        form.integer, lower, upper, _ROUNDS,
    )  # fmt: skip
    if not possible:
        return Impossible("bounds cross when they are propagated")
    n = form.size
    extra = n - instance.size
    q = np.concatenate([instance.q, np.zeros(extra)])
    least, most = row_intervals(C.indptr, C.indices, C.data, lower, upper)
    switch = _switches(instance, form)
    entities = np.flatnonzero(form.integer)
    number = np.full(n, -1)
    number[entities] = np.arange(len(entities))

    # Equations, and integers that bounds have decided
    equal = equations(form.row_lower, form.row_upper)
    fixed = np.flatnonzero((upper - lower <= 0.0) & form.integer & ~switch)
    columns = np.flatnonzero(~switch)
    place = np.full(n, -1)
    place[columns] = np.arange(len(columns))
    dense = A.toarray()
    E = np.zeros((int(equal.sum()) + len(fixed), len(columns)))
    E[len(fixed) :] = dense[equal][:, columns]
    E[np.arange(len(fixed)), place[fixed]] = 1.0
    e = np.concatenate([lower[fixed], form.row_upper[equal]])
    solved = eliminated(E, e, form.integer[columns])
    if not solved.consistent:
        return Impossible("equations contradict each other")
    independent = columns[solved.independent]
    k = len(independent)
    X, start = np.zeros((n, k)), np.zeros(n)
    X[columns], start[columns] = solved.X, solved.center
    low_w, high_w = lower[independent], upper[independent]

    # Cost
    P = np.zeros((n, n)) if extra else instance.P.toarray()
    if extra:
        P[: instance.size, : instance.size] = instance.P.toarray()
    PX = P @ X
    H = X.T @ PX
    g = X.T @ (P @ start + q)
    constant = float(instance.constant + 0.5 * start @ P @ start + q @ start)
    half = 0.5 * (high_w - low_w)
    bounded = np.isfinite(half)
    reach = np.where(bounded, np.maximum(half, 1e-9), 1.0)
    own = float(np.max(np.diag(H) * reach**2, initial=0.0, where=bounded))
    eta = _PROXIMAL * (own or float(np.sum(np.abs(g) * reach, where=bounded)) or 1.0)
    eps = np.where(bounded, eta / reach**2, 0.0)
    eps = np.where(bounded, np.maximum(eps, 1e-9 * np.abs(np.diag(H)).max(initial=0.0)), 0.0)
    eps = np.minimum(eps, np.where(half > 0, np.inf, 1.0))
    center = np.zeros(k)
    center[bounded] = 0.5 * (low_w[bounded] + high_w[bounded])
    regular = H + np.diag(eps)
    try:
        L = np.linalg.cholesky(regular)
        flat = (np.diag(L) ** 2 < _FLAT * np.abs(np.diag(regular)).max(initial=0.0)) & ~bounded
    except np.linalg.LinAlgError:
        flat = ~bounded
        L = np.zeros((0, 0))
    if flat.any() or len(L) != k:
        raise UsageError(
            f"{instance.name}: a direction without cost is not bounded, which branch-and-bound "
            "needs; give its variables bounds, or use micp"
        )
    u = solve_triangular(L, g - eps * center, lower=True) if k else np.zeros(0)

    # Rows in w: bounds, plain rows, conditional rows, and what undecided nodes have of these
    C_w, C_start = C @ X, C @ start
    unequal = np.flatnonzero(~equal)
    keys = KeySpace(n, len(A.indptr) - 1, len(form.when))
    key = [columns, keys.plain + unequal, keys.conditional + np.arange(len(form.when))]
    stack = [X[columns], dense[unequal] @ X, C_w]
    base = np.concatenate([start[columns], A[unequal] @ start, C_start])
    is_entity = form.integer[columns]
    bound_low = np.where(is_entity, lower[columns], form.lower[columns])
    bound_high = np.where(is_entity, upper[columns], form.upper[columns])
    inside = place[independent]
    bound_low[inside], bound_high[inside] = low_w, high_w
    low = np.concatenate([bound_low, form.row_lower[unequal], form.when_lower])
    high = np.concatenate([bound_high, form.row_upper[unequal], form.when_upper])
    plain = len(columns) + len(unequal)
    when = np.repeat(np.array([ALWAYS, DECIDED], np.int8), [plain, len(form.when)])
    entity = np.concatenate([np.full(plain, -1), number[form.when]])
    value = np.concatenate([np.zeros(plain, np.int64), form.value])
    with np.errstate(invalid="ignore"):  # infinite less infinite: there is no such side
        excess_high = np.nan_to_num(np.maximum(most - form.when_upper, 0.0), posinf=np.inf)
        excess_low = np.nan_to_num(np.maximum(form.when_lower - least, 0.0), posinf=np.inf)
    scale = np.maximum(np.where(np.isfinite(excess_high), excess_high, 0.0),
                       np.where(np.isfinite(excess_low), excess_low, 0.0))  # fmt: skip
    share = np.concatenate([np.zeros(plain), 1.0 / np.maximum(scale, 1e-6)])
    order = np.argsort(entity[plain:], kind="stable")
    first = np.searchsorted(entity[plain:][order], np.arange(len(entities) + 1))

    free = lower[form.when] < upper[form.when]
    pairs = paired(
        entities, switch, first, order, form.value, free, excess_low, excess_high,
        form.when_lower, form.when_upper,
    )  # fmt: skip
    a, sign_a, c, sign_c, most_a, most_c, of = pairs
    if len(a):
        key.append(keys.pair(a, sign_a, c, sign_c))
        x_a, x_c = (sign_a / most_a)[:, None], (sign_c / most_c)[:, None]
        stack.append(x_a * C_w[a] + x_c * C_w[c])
        base = np.concatenate([base, sign_a / most_a * C_start[a] + sign_c / most_c * C_start[c]])
        edge_a = np.where(sign_a > 0, form.when_upper[a], form.when_lower[a])
        edge_c = np.where(sign_c > 0, form.when_upper[c], form.when_lower[c])
        low = np.concatenate([low, np.full(len(a), -np.inf)])
        high = np.concatenate([high, 1.0 + sign_a / most_a * edge_a + sign_c / most_c * edge_c])
        when = np.concatenate([when, np.full(len(a), UNDECIDED, np.int8)])
        entity = np.concatenate([entity, of])
        value = np.concatenate([value, np.zeros(len(a), np.int64)])
        share = np.concatenate([share, np.zeros(len(a))])
    for sign, bound, excess in ((1.0, form.when_upper, excess_high),
                                (-1.0, form.when_lower, excess_low)):  # fmt: skip
        here = np.flatnonzero(
            ~switch[form.when] & free & np.isfinite(bound) & np.isfinite(excess) & (excess > 0)
        )
        if not len(here):
            continue
        # a x + M z <= b + M where z = 1 has the row, a x - M z <= b where z = 0 has
        slope = np.where(form.value[here] == 1, excess[here], -excess[here])
        z = form.when[here]
        key.append(keys.big_m(here, sign))
        stack.append(sign * C_w[here] + slope[:, None] * X[z])
        base = np.concatenate([base, sign * C_start[here] + slope * start[z]])
        low = np.concatenate([low, np.full(len(here), -np.inf)])
        room = np.where(form.value[here] == 1, excess[here], 0.0)
        high = np.concatenate([high, sign * bound[here] + room])
        when = np.concatenate([when, np.full(len(here), UNDECIDED, np.int8)])
        entity = np.concatenate([entity, number[z]])
        value = np.concatenate([value, np.zeros(len(here), np.int64)])
        share = np.concatenate([share, np.zeros(len(here))])

    R = np.vstack(stack)
    low, high = low - base, high - base
    # What holds all over the box is no row, but for conditional ones and integers
    positive, negative = np.maximum(R, 0.0), np.minimum(R, 0.0)
    with np.errstate(invalid="ignore"):
        finite_low = np.where(np.isfinite(low_w), low_w, -1e30)
        finite_high = np.where(np.isfinite(high_w), high_w, 1e30)
        least_row = positive @ finite_low + negative @ finite_high
        most_row = positive @ finite_high + negative @ finite_low
    size = 1e-10 * np.maximum(1.0, np.maximum(np.abs(least_row), np.abs(most_row)))
    if (
        (when == ALWAYS) & ((least_row > high + 1e-7 + size) | (most_row < low - 1e-7 - size))
    ).any():
        return Impossible("a row cannot hold within the bounds")
    implied = (least_row >= low - size) & (most_row <= high + size)
    kept = ~implied
    kept[inside] = True
    kept[: len(columns)] |= is_entity
    kept[plain : plain + len(form.when)] = True
    kept &= np.isfinite(low) | np.isfinite(high)
    length = np.abs(R).max(axis=1, initial=0.0)
    # An empty conditional row that fails excludes a value, which propagation has seen
    kept &= length > 1e-12
    keep = np.flatnonzero(kept)
    new_place = np.full(len(R), -1)
    new_place[keep] = np.arange(len(keep))
    R, low, high = R[keep], low[keep], high[keep]
    M = solve_triangular(L, R.T, lower=True).T if k else R
    norm = np.maximum(np.linalg.norm(M, axis=1), 1e-300)
    M = np.ascontiguousarray(M / norm[:, None])
    at = -(M @ u)  # value at v = 0, by unit of v
    rows_of = new_place[plain + order]
    first_kept = np.concatenate([[0], np.cumsum(rows_of >= 0)])[first]
    column = np.full(len(entities), -1)
    with_column = ~switch[entities]
    column[with_column] = new_place[place[entities[with_column]]]
    ball_rows, ball, radius = _balls(instance, X, start)
    numbers = Numbers(
        lower=low / norm - at,
        upper=high / norm - at,
        norm=norm,
        offset=at * norm + base[keep],
        when=when[keep],
        entity=entity[keep].astype(np.int64),
        value=value[keep].astype(np.int64),
        share=share[keep],
        column=column.astype(np.int64),
        first=first_kept.astype(np.int64),
        rows_of=rows_of[rows_of >= 0].astype(np.int64),
        group=_groups(form, number).astype(np.int64),
        lowest=lower[entities].astype(np.int64),
        highest=upper[entities].astype(np.int64),
        L=np.ascontiguousarray(L),
        U=np.ascontiguousarray(L.T),
        u=u,
        eps=eps,
        center=center,
        box_lower=low_w,
        box_upper=high_w,
        H=np.ascontiguousarray(H),
        g=g,
        constant=constant,
        ceiling=_ceiling(H, g, constant, low_w, high_w),
        ball_rows=ball_rows,
        ball=ball,
        radius=radius,
    )
    tolerance = np.maximum(_FEASIBLE / norm, 1e-13)
    return MixedIntegerProgram(
        numbers,
        M,
        np.ascontiguousarray(M.T),
        tolerance,
        X,
        start,
        entities,
        np.concatenate(key)[keep],
        lower,
        upper,
        independent,
    )


def equations(lower: Array, upper: Array) -> NDArray[np.bool_]:
    """(m,) which rows have the same bound on both sides."""
    return np.isfinite(upper) & (upper - lower <= _EQUAL * np.maximum(1.0, np.abs(upper)))


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


def _ceiling(H: Array, g: Array, constant: float, lower: Array, upper: Array) -> float:
    """No point of the box costs more; where it is open, far more than can be told apart."""
    most = np.maximum(np.abs(lower), np.abs(upper))
    if np.isfinite(most).all():
        return constant + float(np.abs(g) @ most + 0.5 * most @ np.abs(H) @ most)
    return 1e15 * max(1.0, abs(constant), float(np.abs(g).max(initial=0.0)))


def _switches(instance: Instance, form: Conditional) -> NDArray[np.bool_]:
    """Binaries that stand in conditional rows alone, few enough of them to be paired."""
    alone = np.zeros(form.size, bool)
    alone[form.when] = True
    alone[form.A.indices[form.A.data != 0]] = False
    alone[form.C.indices[form.C.data != 0]] = False
    n = instance.size
    alone[:n] &= (instance.q == 0) & (np.diff(instance.P.indptr) == 0)
    sides = np.isfinite(form.when_lower).astype(int) + np.isfinite(form.when_upper)
    ones = np.bincount(form.when, sides * (form.value == 1), form.size)
    zeros = np.bincount(form.when, sides * (form.value == 0), form.size)
    return alone & form.integer & (ones * zeros <= _PAIRS * (ones + zeros))


def _groups(form: Conditional, number: Indices) -> Indices:
    """Exactly-one group of each integer: rows that add binaries up to one."""
    group = np.full(int((number >= 0).sum()), -1)
    A = form.A
    for r in np.flatnonzero((form.row_lower == 1.0) & (form.row_upper == 1.0)):
        here = slice(A.indptr[r], A.indptr[r + 1])
        members = A.indices[here]
        if (A.data[here] == 1.0).all() and form.integer[members].all():
            group[number[members]] = r
    return group


@compiled
def row_intervals(
    pointer: NDArray[np.int32], index: NDArray[np.int32], data: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """Least and largest value of every row over the box."""
    m = len(pointer) - 1
    least, most = np.empty(m), np.empty(m)
    for r in range(m):
        least[r], most[r] = interval(pointer[r], pointer[r + 1], index, data, lower, upper)
    return least, most


@compiled
def paired(
    entities: NDArray[np.int64],
    switch: NDArray[np.bool_],
    first: NDArray[np.int64],
    order: NDArray[np.int64],
    value: NDArray[np.int64],
    free: NDArray[np.bool_],
    excess_low: Array,
    excess_high: Array,
    when_lower: Array,
    when_upper: Array,
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64], Array, Array, Array, NDArray[np.int64]]:
    """For each undecided switch every side of a row for 1 with every side of a row for 0.

    Rows, signs, excesses and the integer; sides without an excess or without a finite one are left.
    """
    count = 0
    for turn in range(2):
        if turn == 1:
            a, c = np.empty(count, np.int64), np.empty(count, np.int64)
            sign_a, sign_c = np.empty(count), np.empty(count)
            most_a, most_c = np.empty(count), np.empty(count)
            of = np.empty(count, np.int64)
            count = 0
        for s in range(len(entities)):
            if not switch[entities[s]]:
                continue
            for i in range(first[s], first[s + 1]):
                one = order[i]
                if value[one] != 1 or not free[one]:
                    continue
                for j in range(first[s], first[s + 1]):
                    zero = order[j]
                    if value[zero] != 0:
                        continue
                    for side in range(4):
                        up_a, up_c = side < 2, side % 2 == 0
                        m_a = excess_high[one] if up_a else excess_low[one]
                        m_c = excess_high[zero] if up_c else excess_low[zero]
                        if not (m_a > _SLACK and m_c > _SLACK):
                            continue
                        if np.isinf(m_a) or np.isinf(m_c):
                            continue
                        if turn == 1:
                            a[count], c[count], of[count] = one, zero, s
                            sign_a[count] = 1.0 if up_a else -1.0
                            sign_c[count] = 1.0 if up_c else -1.0
                            most_a[count], most_c[count] = m_a, m_c
                        count += 1
    return a, sign_a, c, sign_c, most_a, most_c, of
