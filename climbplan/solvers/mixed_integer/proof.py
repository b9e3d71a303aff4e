"""The certificate of a tree: its leaves' multipliers, told in the rows of the statement.

A search works on unit rows in other coordinates, some of which join two conditional rows. Each of
its multipliers is one or two of the statement's; equations, which it has eliminated, get theirs
from what is left of the Lagrangian's slope. Leaves without a point get the multipliers of the
linear program that asks by how much their rows must be let out (`empty_leaf`).
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import solve_triangular

from climbplan.certificates.box import implied_box
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.checker import TOLERANCE, check
from climbplan.certificates.lagrangian import proved
from climbplan.certificates.rows import StatedRows, stated_rows
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.empty_leaf import multipliers_of_empty
from climbplan.solvers.mixed_integer.form import equations
from climbplan.solvers.mixed_integer.keys import BIG_M, CONDITION, PAIR, PLAIN, VARIABLE, KeySpace
from climbplan.solvers.mixed_integer.nodes import Search, Tree
from climbplan.solvers.mixed_integer.numbers import MixedIntegerProgram
from climbplan.solvers.mixed_integer.pairs import row_intervals
from climbplan.solvers.mixed_integer.search import settle
from climbplan.solvers.result import LEAST_OBJECTIVE

_LEFT = (place.OPEN, place.CLOSED, place.EMPTY_NODE, place.LEFT)
_ROUNDING = 1e-9  # by which bounds are let out that nothing else uses
_SHORT = 1e-9  # by which a leaf may prove less than the tree says, relative
_WIDEST = 1e6  # weight of a variable's slope, at most


def certificate_of(
    instance: Instance,
    form: Conditional,
    program: MixedIntegerProgram,
    search: Search,
    tree: Tree,
    bound: float,
    deadline: float = np.inf,
) -> Certificate:
    """What a tree that has run proves, as far as it has come.

    bound: what it says itself; leaves are worked on only where they prove less. deadline: of
    `time.perf_counter` [s], after which they keep what they have, and the certificate proves less.
    """
    count = int(search.whole[place.COUNT])
    leaves = np.flatnonzero(np.isin(tree.state[:count], _LEFT))
    low, high = tree.low[leaves].astype(np.int64), tree.high[leaves].astype(np.int64)
    sets = _sets(instance, form, program, low, high)
    rows = stated_rows(instance)
    some = _some_alternative(rows, sets[2])
    leaves, sets = leaves[some], (sets[0][some], sets[1][some], sets[2][some])
    box = _box(instance, rows, program)
    told = _told(instance, form, program, search, tree, leaves, sets, box)
    # Multipliers of some leaves are their parents', or those from before tangents were found
    reached = proved(instance, rows, told, TOLERANCE).bound
    best, gap = search.real[place.BEST], search.real[place.GAP]
    enough = best - gap * max(abs(best), LEAST_OBJECTIVE) if np.isfinite(best) else np.inf
    short = min(enough, bound - _SHORT * max(abs(bound), 1.0)) if np.isfinite(bound) else enough
    weak = np.flatnonzero(reached < short)
    told = _settled(instance, form, program, search, tree, leaves, told, weak, deadline)
    empty = tree.state[leaves] == place.EMPTY_NODE
    if np.isfinite(short):
        empty &= proved(instance, rows, told, TOLERANCE).bound < short
    return _finished(instance, form, told, np.flatnonzero(empty), deadline)


def _box(instance: Instance, rows: StatedRows, program: MixedIntegerProgram) -> tuple[Array, Array]:
    """The search's box, and where that is open what the checker finds, balls among it."""
    lower, upper = program.lower[: instance.size].copy(), program.upper[: instance.size].copy()
    if np.isfinite(lower).all() and np.isfinite(upper).all():
        return lower, upper
    nowhere = np.full(instance.size, np.inf)
    box = implied_box(instance, rows, nowhere, -nowhere, TOLERANCE)
    for side, found, sign in ((lower, box.lower, -1.0), (upper, box.upper, 1.0)):
        open_ones = np.isinf(side)
        side[open_ones] = (found + sign * _ROUNDING * (1.0 + np.abs(found)))[open_ones]
    return lower, upper


def _told(
    instance: Instance,
    form: Conditional,
    program: MixedIntegerProgram,
    search: Search,
    tree: Tree,
    leaves: Index,
    sets: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]],
    box: tuple[Array, Array],
) -> Certificate:
    """What leaves have stored."""
    telling = _Telling(instance, form, program, search)
    point, multiplier, ball = telling.multipliers(_stored(tree, leaves, int(search.rows.used[0])))
    low, high, allowed = sets
    return Certificate(
        lower=box[0],
        upper=box[1],
        low=low,
        high=high,
        allowed=allowed,
        point=point,
        multiplier=multiplier,
        ball=ball,
        empty=np.zeros(len(leaves), bool),
        bound=-np.inf,
    )


def _settled(
    instance: Instance,
    form: Conditional,
    program: MixedIntegerProgram,
    search: Search,
    tree: Tree,
    leaves: Index,
    told: Certificate,
    weak: Index,
    deadline: float,
) -> Certificate:
    """Some leaves solved again, each told while the proximal term has its centre where it was."""
    point, multiplier, ball = told.point.copy(), told.multiplier.tolil(), told.ball.copy()
    telling: _Telling | None = None
    for s in weak:
        if time.perf_counter() >= deadline:
            break
        settle(program.numbers, search, tree, leaves[s])
        used = int(search.rows.used[0])
        if telling is None or telling.used != used:  # tangents were found
            telling = _Telling(instance, form, program, search)
        parts = telling.multipliers(_stored(tree, leaves[s : s + 1], used))
        point[s], multiplier[s], ball[s] = parts[0][0], parts[1], parts[2][0]
    return replace(told, point=point, multiplier=sparse.csr_matrix(multiplier), ball=ball)


def certificate_of_nothing(instance: Instance, form: Conditional) -> Certificate:
    """That an instance has no point at all, found before any search.

    Bounds that cross when they are propagated need no leaf. What equations contradict is proved by
    one leaf with everything open.
    """
    integers = np.flatnonzero(instance.integer)
    alternatives = sum(len(choice.alternatives) for choice in instance.choices)
    rows = len(instance.row_lower) + len(form.when)
    coordinates = sum(balls.f.size for balls in instance.balls)
    n, lower, upper = instance.size, instance.lower.astype(float), instance.upper.astype(float)
    none = Certificate(
        lower=np.full(n, np.inf),
        upper=np.full(n, -np.inf),
        low=np.zeros((0, len(integers)), np.int64),
        high=np.zeros((0, len(integers)), np.int64),
        allowed=np.ones((0, alternatives), bool),
        point=np.zeros((0, n)),
        multiplier=sparse.csr_matrix((0, rows)),
        ball=np.zeros((0, coordinates)),
        empty=np.zeros(0, bool),
        bound=np.inf,
    )
    if check(instance, none).infeasible:
        return none
    one = replace(
        none,
        lower=lower,
        upper=upper,
        low=np.ceil(lower[integers]).astype(np.int64)[None],
        high=np.floor(upper[integers]).astype(np.int64)[None],
        allowed=np.ones((1, alternatives), bool),
        point=np.zeros((1, n)),
        multiplier=sparse.csr_matrix((1, rows)),
        ball=np.zeros((1, coordinates)),
        empty=np.zeros(1, bool),
    )
    return _finished(instance, form, one, np.array([0]))


def _finished(
    instance: Instance,
    form: Conditional,
    certificate: Certificate,
    empty: Index,
    deadline: float = np.inf,
) -> Certificate:
    """With the multipliers of empty leaves, and the bound that the checker finds."""
    multiplier = certificate.multiplier.tolil()
    ball, proved = certificate.ball.copy(), np.zeros(certificate.count, bool)
    for s in empty:
        if time.perf_counter() >= deadline:
            break
        found = multipliers_of_empty(instance, form, certificate, int(s))
        if found is not None:
            multiplier[s], ball[s], proved[s] = found.multiplier, found.ball, True
    whole = replace(certificate, multiplier=sparse.csr_matrix(multiplier), ball=ball, empty=proved)
    return replace(whole, bound=check(instance, whole).bound)


def _stored(tree: Tree, leaves: Index, rows: int) -> sparse.csr_matrix:
    """(S, rows) multipliers with the sign of their side: positive at the upper bound."""
    width = tree.row.shape[1]
    here = np.arange(width) < tree.active[leaves][:, None]
    signed = tree.multiplier[leaves] * tree.side[leaves]
    leaf = np.repeat(np.arange(len(leaves)), width)[here.ravel()]
    return sparse.csr_matrix(
        (signed[here], (leaf, tree.row[leaves][here])), shape=(len(leaves), rows)
    )


def _sets(
    instance: Instance,
    form: Conditional,
    program: MixedIntegerProgram,
    low: NDArray[np.int64],
    high: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Ranges of the instance's integers and alternatives of its choices, leaf by leaf."""
    number = np.full(form.size, -1)
    number[program.entities] = np.arange(len(program.entities))
    stated = number[np.flatnonzero(instance.integer)]
    allowed = []
    for choice, binaries in zip(instance.choices, form.choice, strict=True):
        least, most = low[:, number[binaries]], high[:, number[binaries]]
        if len(choice.alternatives) == 2:  # a switch, 1 for the first alternative
            allowed += [most[:, 0] == 1, least[:, 0] == 0]
        else:
            given = (least == 1).any(axis=1)
            allowed += list(np.where(given[:, None], least == 1, most == 1).T)
    held = np.stack(allowed, axis=1) if allowed else np.zeros((len(low), 0), bool)
    return low[:, stated], high[:, stated], held


def _some_alternative(rows: StatedRows, allowed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(S,) leaves that leave each choice an alternative: others hold nothing."""
    kept = np.ones(len(allowed), bool)
    for k in np.unique(rows.choice):
        kept &= allowed[:, rows.choice == k].any(axis=1)
    return kept


class _Telling:
    """Multipliers of a search's rows as those of the statement's."""

    def __init__(
        self, instance: Instance, form: Conditional, program: MixedIntegerProgram, search: Search
    ) -> None:
        self._instance, self._program, self._search = instance, program, search
        self._plain = len(instance.row_lower)
        n, m, c = instance.size, self._plain, len(form.when)
        self._G = sparse.vstack([instance.A, form.C[:, :n]]).tocsr()
        self.used = used = int(search.rows.used[0])
        stated = len(program.key)
        kind, row, side = KeySpace(form.size, len(form.row_lower), c).parts(program.key)
        least, most = row_intervals(
            form.C.indptr, form.C.indices, form.C.data, program.lower, program.upper
        )
        with np.errstate(invalid="ignore"):  # a side that is not there
            fails = {1: most - form.when_upper, -1: form.when_lower - least}
        at: list[tuple[Index, Index, Array]] = []  # row of the search, of the statement, share
        here = np.flatnonzero((kind == PLAIN) & (row[:, 0] < m))
        at.append((here, row[here, 0], np.ones(len(here))))
        here = np.flatnonzero(kind == CONDITION)
        at.append((here, m + row[here, 0], np.ones(len(here))))
        for k in range(2):
            here = np.flatnonzero(kind == PAIR)
            of, up = row[here, k], side[here, k]
            at.append((here, m + of, up / np.where(up > 0, fails[1][of], fails[-1][of])))
        big = np.flatnonzero(kind == BIG_M)
        of, up = row[big, 0], side[big, 0]
        at.append((big, m + of, up.astype(float)))
        self._rows = _matrix(at, (used, m + c))
        bounds = np.flatnonzero((kind == VARIABLE) & (row[:, 0] < n))
        slope = np.where(up > 0, fails[1][of], fails[-1][of])
        slope = np.where(form.value[of] == 1, slope, -slope)
        z, inside = form.when[of], form.when[of] < n
        self._columns = _matrix(
            [
                (bounds, row[bounds, 0], np.ones(len(bounds))),
                (big[inside], z[inside], slope[inside]),
            ],
            (used, n),
        )
        self._F = sparse.vstack([sparse.csr_matrix((0, n)), *(b.F for b in instance.balls)]).tocsr()
        self._tangents = _tangents(instance, search, stated, used)

    def multipliers(self, of: sparse.csr_matrix) -> tuple[Array, sparse.csr_matrix, Array]:
        """Points (S, n), multipliers (S, rows) and balls (S, D) of a search's multipliers."""
        instance, program, search = self._instance, self._program, self._search
        n, used = instance.size, of.shape[1]
        numbers = program.numbers
        # Where the cost with its proximal term has the slope of the rows
        v = -np.asarray(of @ search.rows.M[:used])
        w = solve_triangular(numbers.U, (v - search.u).T, lower=False).T
        point = (w @ program.X.T + program.start)[:, :n]
        share = of @ sparse.diags(1.0 / numbers.norm[:used])
        multiplier = -np.asarray((share @ self._rows).todense())
        ball = np.asarray(share @ self._tangents)
        slope = instance.q + np.asarray((instance.P @ point.T).T)
        slope -= np.asarray((self._G.T @ multiplier.T).T)
        slope += np.asarray((share @ self._columns).todense())
        slope += np.asarray((self._F.T @ ball.T).T)
        multiplier += self._of_equations(slope)
        return point, sparse.csr_matrix(multiplier), ball

    def _of_equations(self, slope: Array) -> Array:
        """(S, rows) multipliers that leave no slope of what equations were solved for.

        What is left of the others' slopes is that of the proximal term, as in the search.
        """
        instance = self._instance
        equal = np.flatnonzero(equations(instance.row_lower, instance.row_upper))
        out = np.zeros((len(slope), self._G.shape[0]))
        if not len(equal):
            return out
        n = instance.size
        width = np.minimum(self._program.upper[:n] - self._program.lower[:n], _WIDEST)
        solved = width > 0.0
        solved[self._program.independent[self._program.independent < n]] = False
        weight = width[solved]
        E = instance.A[equal].toarray()[:, solved] * weight
        out[:, equal] = np.linalg.lstsq(E.T, (slope[:, solved] * weight).T, rcond=1e-13)[0].T
        return out


def _matrix(entries: list[tuple[Index, Index, Array]], shape: tuple[int, int]) -> sparse.csr_matrix:
    row, column, value = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.csr_matrix((value, (row, column)), shape=shape)


def _tangents(instance: Instance, search: Search, stated: int, used: int) -> Array:
    """(used, D) direction of the ball to which each of the last rows is a tangent."""
    sizes = [balls.f.shape[1] for balls in instance.balls for _ in range(balls.count)]
    begin = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    out = np.zeros((used, int(begin[-1])))
    for r in range(stated, used):
        b = search.tangent_to[r]
        out[r, begin[b] : begin[b + 1]] = search.direction[r, : sizes[b]]
    return out
