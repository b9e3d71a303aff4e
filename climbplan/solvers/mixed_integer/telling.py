"""Multipliers of a search's rows, told in the rows that certificates are written in.

A search works on unit rows in other coordinates, some of which join two conditional rows. Each of
its multipliers is one or two of the statement's; equations, which it has eliminated, get theirs
from what is left of the Lagrangian's slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import Box
from climbplan.certificates.lagrangian import lagrangian
from climbplan.certificates.rows import StatedRows
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.form import equations
from climbplan.solvers.mixed_integer.keys import BIG_M, CONDITION, PAIR, PLAIN, VARIABLE, KeySpace
from climbplan.solvers.mixed_integer.nodes import Search, Tree
from climbplan.solvers.mixed_integer.numbers import MixedIntegerProgram
from climbplan.solvers.mixed_integer.pairs import row_intervals

_WIDEST = 1e6  # weight of a variable's slope, at most
_PLANES = np.array([-1.0, -1.0, 1.0, 1.0])  # sign of an envelope's planes in the search


class Multipliers(NamedTuple):
    """As a certificate has them of a leaf."""

    point: Array | None  # (n,) none of a leaf that they shall prove empty
    rows: Array  # (rows + 4 K,)
    ball: Array  # (D,)


class Searched(NamedTuple):
    """A search, and the instance that it is of, linear in its products."""

    instance: Instance
    form: Conditional
    program: MixedIntegerProgram
    search: Search
    tree: Tree
    space: IntArray  # (F,) factors of products that it splits

    @property
    def used(self) -> int:
        """Rows, tangents among them."""
        return int(self.search.rows.used[0])


class Telling:
    """The way from a search's rows to those of a certificate, until it finds further tangents."""

    def __init__(self, stated: Instance, rows: StatedRows, of: Searched) -> None:
        """Of a statement whose `of.instance` is linear in its products."""
        self._stated, self._stated_rows, self._of = stated, rows, of
        form, program, used = of.form, of.program, of.used
        self.used = used
        m, n = len(stated.row_lower), stated.size
        column = np.concatenate([np.arange(n), rows.w])  # in v, of x and of w
        kind, row, side = _parts(form, program, used)
        fails = _fails(form, program)
        at = []  # rows of the search, of the certificate, shares
        here = np.flatnonzero((kind == PLAIN) & (row[:, 0] < m))
        at.append((here, row[here, 0], np.ones(len(here))))
        here = np.flatnonzero(kind == CONDITION)
        at.append((here, m + row[here, 0], np.ones(len(here))))
        for k in range(2):
            here = np.flatnonzero(kind == PAIR)
            which, up = row[here, k], side[here, k]
            at.append((here, m + which, up / np.where(up > 0, fails[0][which], fails[1][which])))
        here = np.flatnonzero(kind == BIG_M)
        at.append((here, m + row[here, 0], side[here, 0].astype(float)))
        spatial, K = program.numbers.spatial, len(rows.w)
        planes = (spatial.begin[:, None] + np.arange(4)).ravel()
        behind = len(rows.lower) + np.arange(4 * K)
        at.append((planes, behind, np.tile(_PLANES, K)))
        self._rows = _matrix(at, (used, len(rows.lower) + 4 * K))
        here = np.flatnonzero((kind == VARIABLE) & (row[:, 0] < len(column)))
        factors = program.numbers.column[len(program.entities) :]
        bounds = [(here, column[row[here, 0]], np.ones(len(here)))]
        bounds.append((factors, of.space, np.ones(len(factors))))
        bounds.append((spatial.place, rows.w, np.ones(K)))
        self._bounds = _matrix(bounds, (used, len(rows.integer)))
        self._tangents = sparse.csr_matrix(_tangents(stated, of.search, len(program.key), used))
        self._equal = np.flatnonzero(equations(stated.row_lower, stated.row_upper))
        width = np.minimum(program.upper[: len(column)] - program.lower[: len(column)], _WIDEST)
        width[program.independent[program.independent < len(column)]] = 0.0
        self._solved, self._weight = column[width > 0.0], width[width > 0.0]
        E = rows.G[self._equal].toarray()[:, self._solved] * self._weight
        self._inverse = np.linalg.pinv(E.T, rcond=1e-13)

    def multipliers(self, leaf: int, rows: StatedRows, box: Box) -> Multipliers:
        """What a leaf has stored; rows: with the planes of its box."""
        tree, numbers, search = self._of.tree, self._of.program.numbers, self._of.search
        here = slice(0, tree.active[leaf])
        signed = tree.multiplier[leaf, here] * tree.side[leaf, here]  # positive at upper bounds
        at = tree.row[leaf, here]
        # Where the cost with its proximal term has the slope of the rows
        v = -(signed @ search.rows.M[at])
        w = solve_triangular(numbers.U, v - search.u, lower=False)
        point = (self._of.program.X @ w + self._of.program.start)[: self._stated.size]
        share = sparse.csr_matrix(
            (signed / numbers.norm[at], (np.zeros(len(at), int), at)), (1, self.used)
        )
        y, ball = -(share @ self._rows).toarray()[0], (share @ self._tangents).toarray()[0]
        if len(self._equal):
            # What is left of the others' slopes is that of the proximal term, as in the search
            slope = lagrangian(self._stated, rows, box, point, y, ball).slope[:-1]
            slope += (share @ self._bounds).toarray()[0]
            y[self._equal] += self._inverse @ (slope[self._solved] * self._weight)
        return Multipliers(point, y, ball)


def _parts(
    form: Conditional, program: MixedIntegerProgram, used: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Kind, rows and sides of what a search's rows are; -1 for those of products and tangents."""
    key = np.full(used, -1)
    key[: len(program.key)] = program.key
    keys = KeySpace(form.size, len(form.row_lower), len(form.when))
    kind, row, side = keys.parts(np.maximum(key, 0))
    return np.where(key < 0, -1, kind), row, side


def _fails(form: Conditional, program: MixedIntegerProgram) -> tuple[Array, Array]:
    """By how much the upper and the lower side of each conditional row can fail."""
    C = form.C
    least, most = row_intervals(C.indptr, C.indices, C.data, program.lower, program.upper)
    with np.errstate(invalid="ignore"):  # a side that is not there
        return most - form.when_upper, form.when_lower - least


def _matrix(
    entries: list[tuple[IntArray, IntArray, Array]], shape: tuple[int, int]
) -> sparse.csr_matrix:
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
