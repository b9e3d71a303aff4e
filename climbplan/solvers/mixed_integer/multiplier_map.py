"""Map multipliers of a search's rows to the rows in which certificates are written.

A search works on unit rows in reduced coordinates, some of which combine two indicator rows. Each
of its multipliers maps to one or two of the stated rows. Equations, which presolve has eliminated,
get multipliers from the remaining gradient of the Lagrangian.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import CertificateBox
from climbplan.certificates.lagrangian import build_lagrangian
from climbplan.certificates.rows import CertificateRows
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.nodes import NodeTree, SearchState
from climbplan.solvers.mixed_integer.presolve import find_equations
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram
from climbplan.solvers.mixed_integer.row_keys import (
    BIG_M,
    CONDITION,
    PAIR,
    PLAIN,
    VARIABLE,
    KeySpace,
)
from climbplan.solvers.mixed_integer.switch_pairs import compute_row_intervals

_WIDEST = 1e6  # largest weight of a variable's slope
_PLANES = np.array([-1.0, -1.0, 1.0, 1.0])  # sign of an envelope's planes in the search


class Multipliers(NamedTuple):
    """Multipliers of a leaf, as a certificate stores them."""

    point: Array | None  # (n,) None for a leaf that they prove infeasible
    rows: Array  # (rows + 4 K,)
    ball: Array  # (D,)


class SearchedTree(NamedTuple):
    """A search that has run, and its instance, which is linear in products."""

    instance: Instance
    form: IndicatorForm
    program: MixedIntegerProgram
    search: SearchState
    tree: NodeTree
    space: IntArray  # (F,) factors of products that may be split

    @property
    def num_rows(self) -> int:
        """Number of rows, tangents included."""
        return int(self.search.rows.num_used[0])


class MultiplierMap:
    """Linear map from multipliers of a search's rows to those of a certificate.

    The map is valid until the search adds further tangents.
    """

    def __init__(self, instance: Instance, rows: CertificateRows, tree: SearchedTree) -> None:
        """Build the map for a statement of which `of.instance` is linear in its products."""
        self._stated, self._stated_rows, self._tree = instance, rows, tree
        form, program, num_rows = tree.form, tree.program, tree.num_rows
        self.num_rows = num_rows
        m, n = len(instance.row_lower), instance.size
        column = np.concatenate([np.arange(n), rows.w])  # in v, of x and of w
        kind, row, side = _decode_rows(form, program, num_rows)
        big_m = _compute_big_m(form, program)
        entries = []  # rows of the search, rows of the certificate, factors
        index = np.flatnonzero((kind == PLAIN) & (row[:, 0] < m))
        entries.append((index, row[index, 0], np.ones(len(index))))
        index = np.flatnonzero(kind == CONDITION)
        entries.append((index, m + row[index, 0], np.ones(len(index))))
        for k in range(2):
            index = np.flatnonzero(kind == PAIR)
            indicator_row, sign = row[index, k], side[index, k]
            entries.append(
                (
                    index,
                    m + indicator_row,
                    sign / np.where(sign > 0, big_m[0][indicator_row], big_m[1][indicator_row]),
                )
            )
        index = np.flatnonzero(kind == BIG_M)
        entries.append((index, m + row[index, 0], side[index, 0].astype(float)))
        spatial, K = program.data.spatial, len(rows.w)
        planes = (spatial.envelope_row[:, None] + np.arange(4)).ravel()
        plane_rows = len(rows.lower) + np.arange(4 * K)
        entries.append((planes, plane_rows, np.tile(_PLANES, K)))
        self._rows = _assemble_matrix(entries, (num_rows, len(rows.lower) + 4 * K))
        index = np.flatnonzero((kind == VARIABLE) & (row[:, 0] < len(column)))
        factors = program.data.value_row[len(program.entities) :]
        bounds = [(index, column[row[index, 0]], np.ones(len(index)))]
        bounds.append((factors, tree.space, np.ones(len(factors))))
        bounds.append((spatial.product_row, rows.w, np.ones(K)))
        self._bounds = _assemble_matrix(bounds, (num_rows, len(rows.integer)))
        self._tangents = sparse.csr_matrix(
            _collect_tangents(instance, tree.search, len(program.row_key), num_rows)
        )
        self._equal = np.flatnonzero(find_equations(instance.row_lower, instance.row_upper))
        width = np.minimum(program.upper[: len(column)] - program.lower[: len(column)], _WIDEST)
        width[program.independent[program.independent < len(column)]] = 0.0
        self._solved, self._weight = column[width > 0.0], width[width > 0.0]
        E = rows.G[self._equal].toarray()[:, self._solved] * self._weight
        self._inverse = np.linalg.pinv(E.T, rcond=1e-13)

    def map_leaf(self, leaf: int, rows: CertificateRows, box: CertificateBox) -> Multipliers:
        """Return the multipliers of a leaf; `rows` includes the planes of its box."""
        tree, data, search = self._tree.tree, self._tree.program.data, self._tree.search
        active = slice(0, tree.active[leaf])
        signed = tree.multiplier[leaf, active] * tree.side[leaf, active]  # positive at upper bounds
        active_row = tree.row[leaf, active]
        # Stationary point of the cost with its proximal term
        v = -(signed @ search.rows.M[active_row])
        w = solve_triangular(data.U, v - search.u, lower=False)
        point = (self._tree.program.X @ w + self._tree.program.start)[: self._stated.size]
        unscaled = sparse.csr_matrix(
            (signed / data.norm[active_row], (np.zeros(len(active_row), int), active_row)),
            (1, self.num_rows),
        )
        y, ball = -(unscaled @ self._rows).toarray()[0], (unscaled @ self._tangents).toarray()[0]
        if len(self._equal):
            # Only the gradient of the proximal term may remain, as in the search
            slope = build_lagrangian(self._stated, rows, box, point, y, ball).slope[:-1]
            slope += (unscaled @ self._bounds).toarray()[0]
            y[self._equal] += self._inverse @ (slope[self._solved] * self._weight)
        return Multipliers(point, y, ball)


def _decode_rows(
    form: IndicatorForm, program: MixedIntegerProgram, num_rows: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Decode a search's rows into kind, rows and sides; -1 for rows of products and tangents."""
    key = np.full(num_rows, -1)
    key[: len(program.row_key)] = program.row_key
    keys = KeySpace(form.size, len(form.row_lower), len(form.indicator))
    kind, row, side = keys.decode(np.maximum(key, 0))
    return np.where(key < 0, -1, kind), row, side


def _compute_big_m(form: IndicatorForm, program: MixedIntegerProgram) -> tuple[Array, Array]:
    """Return the largest violations of the upper and the lower side of each indicator row."""
    C = form.C
    minimum, maximum = compute_row_intervals(
        C.indptr, C.indices, C.data, program.lower, program.upper
    )
    with np.errstate(invalid="ignore"):  # infinite minus infinite: a missing side
        return maximum - form.indicator_upper, form.indicator_lower - minimum


def _assemble_matrix(
    entries: list[tuple[IntArray, IntArray, Array]], shape: tuple[int, int]
) -> sparse.csr_matrix:
    """Assemble a sparse matrix from blocks of (row, column, value)."""
    row, column, value = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    return sparse.csr_matrix((value, (row, column)), shape=shape)


def _collect_tangents(instance: Instance, search: SearchState, stated: int, num_rows: int) -> Array:
    """Return (used, D) the normal of each tangent row in the coordinates of its ball."""
    sizes = [balls.f.shape[1] for balls in instance.balls for _ in range(balls.count)]
    begin = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    out = np.zeros((num_rows, int(begin[-1])))
    for r in range(stated, num_rows):
        b = search.tangent_to[r]
        out[r, begin[b] : begin[b + 1]] = search.direction[r, : sizes[b]]
    return out
