"""Products of two variables as mixed-integer linear rows, sections 7.2.2 and 8.1.2.

Each product w = x y becomes a variable. Where x or y has a partition, (x, y, w) is a convex
combination of the vertices of the envelopes of all cells, eqs. (8.12), (8.13); the weights of a
cell add up to the weight delta of its piece, which all products of a variable share. One binary a
piece: delta is binary. log2 N: sum of code_l(i) delta_i = z_l, which implies eq. (8.13c), has one
row a bit instead of one a piece, and leaves unused codes without a solution. The pieces may lie
anywhere. Without a partition, the envelope on the variables' bounds is four rows, eq. (8.26).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array, IntArray
from climbplan.errors import LimitReached, UsageError
from climbplan.program.instance import Instance, Products
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.envelopes import (
    Corners,
    Squares,
    product_corners,
    product_weights,
    square_corners,
    square_weights,
)
from climbplan.reformulations.extension import Extension, RowStack, extended
from climbplan.reformulations.grids import Encoding, Partition, by_variable, code
from climbplan.reformulations.product_rows import (
    Unbounded,
    factor_bounds,
    linear_in_products,
    plain_rows,
)


@dataclass(frozen=True)
class _Factor:
    """One factor of a product over the cells of its partition, or over its bounds."""

    partition: int  # -1 without one
    lower: Array  # (N,)
    upper: Array  # (N,)


@dataclass(frozen=True)
class _Cells:
    """The weights of one product."""

    product: int
    first_weight: int  # its column
    corners: Corners
    x: _Factor
    y: _Factor
    ix: IntArray  # (N,) piece of x in each cell
    iy: IntArray  # (N,)


@dataclass(frozen=True)
class Enveloped(Reformulated):
    """An instance without products: x, w, deltas and bits of each partition, then all weights."""

    partitions: tuple[Partition, ...]
    weights: tuple[IntArray, ...]  # columns of delta, by partition
    bits: tuple[IntArray, ...]  # columns of the code, by partition; none in unary encoding
    cells: tuple[_Cells, ...]
    products: Products

    def pieces(self, x: Array) -> IntArray:
        """The piece of each partition that a point (n,) falls in, or is nearest to."""
        return np.array([p.piece(x) for p in self.partitions], np.int64)

    def integers(self, x: Array, pieces: IntArray | None = None) -> Array:
        """A vector (n',) to pin: the integers of x and those that choose the pieces."""
        chosen = self.pieces(x) if pieces is None else pieces
        out = np.zeros(self.instance.size)
        out[: self.original_size] = x
        out[self.original_size : self.original_size + self.products.count] = self.products.values(x)
        for partition, delta, bits, i in zip(
            self.partitions, self.weights, self.bits, chosen, strict=True
        ):
            out[delta[i]] = 1.0
            out[bits] = code(partition.count)[i] if len(bits) else 0.0
        return out

    def lift(self, x: Array) -> Array:
        """The point (n',) of the relaxation that stands for x (n,), with w the exact products.

        It satisfies all rows that were added if x lies in a piece of every partition (with secants,
        squares are off by the chord's sag).
        """
        out = self.integers(x)
        chosen = self.pieces(x)
        for cell in self.cells:
            i, j = self.products.first[cell.product], self.products.second[cell.product]
            held = np.ones(len(cell.ix), bool)
            for factor, number in ((cell.x, cell.ix), (cell.y, cell.iy)):
                if factor.partition >= 0:
                    held &= number == chosen[factor.partition]
            at = int(np.flatnonzero(held)[0])
            here = Corners(*(part[at : at + 1] for part in _parts(cell.corners)))
            share = (
                square_weights(here, x[[i]]) if i == j else product_weights(here, x[[i]], x[[j]])
            )
            V = share.shape[1]
            out[cell.first_weight + at * V + np.arange(V)] = share[0]
        return out


@dataclass(frozen=True)
class McCormick(Reformulation[Enveloped]):
    """Piecewise envelopes on partitions.

    encoding: `unary` (one binary a piece) or `log2`. squares: `envelope` (tangents and chord) or
    `secant` (the published chord: no relaxation).
    """

    partitions: tuple[Partition, ...] = ()
    encoding: Encoding = "unary"
    squares: Squares = "envelope"
    unbounded: Unbounded = "refuse"  # open: a plane that needs a missing bound is left out

    @classmethod
    def on(
        cls,
        grids: dict[int, ArrayLike],
        encoding: Encoding = "unary",
        squares: Squares = "envelope",
    ) -> McCormick:
        """Intervals (N, 2) by variable index."""
        return cls(by_variable(grids), encoding, squares)

    def __post_init__(self) -> None:
        stated = np.concatenate([np.zeros(0, np.int64), *(p.variables for p in self.partitions)])
        if len(np.unique(stated)) != len(stated):
            raise UsageError("a variable stands in two partitions")

    def accepts(self, instance: Instance) -> bool:
        """Instances that have the partitions' variables, and bounds on every other factor."""
        inside = all((p.variables < instance.size).all() for p in self.partitions)
        return inside and super().accepts(instance)

    def apply(self, instance: Instance) -> Enveloped:
        """Raises UsageError if a factor has neither a partition nor bounds."""
        return self.form(instance).at(instance)

    def form(self, instance: Instance, is_late: Callable[[], bool] = lambda: False) -> EnvelopeForm:
        """Everything that does not depend on the instance's rows, to be used for many instances.

        is_late: whether the time is over. Raises LimitReached once it is.
        """
        box = factor_bounds(instance, self.partitions, self.unbounded)
        low, high = box.lower, box.upper
        n, K = instance.size, instance.products.count
        rows = RowStack()
        lower, upper, integer = [], [], []
        deltas, bits = [], []
        column = n + K
        for partition in self.partitions:
            N, count = partition.count, partition.binary_count(self.encoding)
            delta = np.arange(column, column + N)
            extra = count if self.encoding == "log2" else 0
            z = np.arange(column + N, column + N + extra)
            column += N + extra
            lower.append(np.zeros(N + extra))
            upper.append(np.ones(N + extra))
            unary = self.encoding == "unary" and count > 0
            integer.append(np.concatenate([np.full(N, unary), np.ones(extra, bool)]))
            rows.add(1, [(0, delta, 1.0)], 1.0, 1.0)
            if extra:
                bit, i = np.nonzero(code(N).T)
                rows.add(extra, [(bit, delta[i], 1.0), (np.arange(extra), z, -1.0)], 0.0, 0.0)
            for k, variable in enumerate(partition.variables):
                # The variable lies in its piece, whether products hold it there or not.
                at = [(0, variable, 1.0)]
                rows.add(1, [*at, (0, delta, -partition.lower[:, k])], 0.0, np.inf)
                rows.add(1, [*at, (0, delta, -partition.upper[:, k])], -np.inf, 0.0)
            deltas.append(delta)
            bits.append(z)
        cells = []
        plain = []
        places = self._places()
        for product in range(K):
            if is_late():
                raise LimitReached("the time was over before the envelopes were made")
            found = self._cells(instance.products, product, places, low, high, column)
            if found is None:
                plain.append(product)
                continue
            _weight_rows(rows, found, instance.products, n, deltas)
            size = found.corners.x.size
            lower.append(np.zeros(size))
            upper.append(np.ones(size))
            integer.append(np.zeros(size, bool))
            column += size
            cells.append(found)
        plain_rows(rows, instance.products, np.array(plain, int), box, n, self.squares)
        extension = Extension(
            np.concatenate([np.zeros(0), *lower]),
            np.concatenate([np.zeros(0), *upper]),
            np.concatenate([np.zeros(0, bool), *integer]),
            rows.matrix(column),
            rows.lower,
            rows.upper,
        )
        covering = all(
            p.covers(instance.lower[p.variables], instance.upper[p.variables])
            for p in self.partitions
        )
        square = instance.products.first == instance.products.second
        exact_squares = self.squares == "envelope" or not square.any()
        return EnvelopeForm(
            self.partitions,
            tuple(deltas),
            tuple(bits),
            tuple(cells),
            instance.products,
            extension,
            relaxation=covering and exact_squares,
        )

    def _places(self) -> dict[int, tuple[int, int]]:
        """Return the partition of each variable that has one, and its column there."""
        return {
            int(variable): (p, k)
            for p, partition in enumerate(self.partitions)
            for k, variable in enumerate(partition.variables)
        }

    def _cells(
        self,
        products: Products,
        product: int,
        places: dict[int, tuple[int, int]],
        low: Array,
        high: Array,
        column: int,
    ) -> _Cells | None:
        """The cells of one product, None if neither factor has a partition."""
        i, j = int(products.first[product]), int(products.second[product])
        x, y = (self._factor(variable, places, low, high) for variable in (i, j))
        if x.partition < 0 and y.partition < 0:
            return None
        if x.partition == y.partition:
            ix = iy = np.arange(len(x.lower))
        else:
            ix, iy = (
                part.ravel()
                for part in np.meshgrid(
                    np.arange(len(x.lower)), np.arange(len(y.lower)), indexing="ij"
                )
            )
        if i == j:
            corners = square_corners(x.lower, x.upper, self.squares)
        else:
            corners = product_corners(x.lower[ix], x.upper[ix], y.lower[iy], y.upper[iy])
        return _Cells(product, column, corners, x, y, ix, iy)

    def _factor(
        self, variable: int, places: dict[int, tuple[int, int]], low: Array, high: Array
    ) -> _Factor:
        if variable not in places:
            return _Factor(-1, low[[variable]], high[[variable]])
        p, k = places[variable]
        partition = self.partitions[p]
        return _Factor(p, partition.lower[:, k], partition.upper[:, k])


@dataclass(frozen=True)
class EnvelopeForm:
    """The variables and rows that take the place of products, for instances with the same ones."""

    partitions: tuple[Partition, ...]
    weights: tuple[IntArray, ...]
    bits: tuple[IntArray, ...]
    cells: tuple[_Cells, ...]
    products: Products
    extension: Extension
    relaxation: bool

    def at(self, instance: Instance) -> Enveloped:
        """The instance with its products replaced; its bounds must be those of the form's."""
        linear = linear_in_products(instance)
        return Enveloped(
            extended(linear, self.extension),
            instance.size,
            self.relaxation,
            self.partitions,
            self.weights,
            self.bits,
            self.cells,
            self.products,
        )


def _parts(corners: Corners) -> tuple[Array, Array, Array]:
    return corners.x, corners.y, corners.w


def _weight_rows(
    rows: RowStack, cells: _Cells, products: Products, n: int, deltas: list[IntArray]
) -> None:
    """(x, y, w) = sum of weights times corners; weights of a piece's cells add up to its delta."""
    i, j = products.first[cells.product], products.second[cells.product]
    N, V = cells.corners.x.shape
    weight = cells.first_weight + np.arange(N * V)
    linked = [(i, cells.corners.x), (n + cells.product, cells.corners.w)]
    if i != j:
        linked.append((j, cells.corners.y))
    for variable, value in linked:
        rows.add(1, [(0, weight, value.ravel()), (0, variable, -1.0)], 0.0, 0.0)
    for factor, number in ((cells.x, cells.ix), (cells.y, cells.iy)):
        if factor.partition < 0:
            continue
        delta = deltas[factor.partition]
        entries = [(np.repeat(number, V), weight, 1.0), (np.arange(len(delta)), delta, -1.0)]
        rows.add(len(delta), entries, 0.0, 0.0)
        if cells.x.partition == cells.y.partition:
            break
