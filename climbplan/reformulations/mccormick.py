"""Products of two variables as mixed-integer linear rows, sections 7.2.2 and 8.1.2.

Each product w = x y becomes a variable. Where x or y has a partition, (x, y, w) is a convex
combination of the vertices of the envelopes of all cells, eqs. (8.12), (8.13). The weights of a
cell sum to the weight delta of its piece, which all products of a variable share. In unary encoding
delta is binary. In log2 encoding sum of code_l(i) delta_i = z_l implies eq. (8.13c); it has one row
for each bit instead of one for each piece, and unused codes have no solution. The pieces may lie
anywhere. Without a partition, the envelope on the variables' bounds is four rows, eq. (8.26).

Published methods, and equation and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import LimitReached, UsageError
from climbplan.program.instance import Instance, Products
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.envelopes import (
    Corners,
    Squares,
    compute_product_corners,
    compute_product_weights,
    compute_square_corners,
    compute_square_weights,
)
from climbplan.reformulations.extension import Extension, TripletRows, extend_instance
from climbplan.reformulations.grids import Encoding, Partition, build_code, by_variable
from climbplan.reformulations.product_rows import (
    Unbounded,
    append_envelope_rows,
    compute_factor_bounds,
    linearise_products,
)


@dataclass(frozen=True)
class _Factor:
    """One factor of a product over the cells of its partition, or over its bounds."""

    partition: int  # -1 without one
    lower: Array  # (N,)
    upper: Array  # (N,)


@dataclass(frozen=True)
class _CellWeights:
    """The weights of one product."""

    product: int
    first_weight: int  # its column
    corners: Corners
    x: _Factor
    y: _Factor
    ix: IntArray  # (N,) piece of x in each cell
    iy: IntArray  # (N,)


@dataclass(frozen=True)
class EnvelopedInstance(Reformulated):
    """An instance without products: x, w, deltas and bits of each partition, then all weights."""

    partitions: tuple[Partition, ...]
    weights: tuple[IntArray, ...]  # columns of delta, by partition
    bits: tuple[IntArray, ...]  # columns of the code, by partition; none in unary encoding
    cells: tuple[_CellWeights, ...]
    products: Products

    def find_pieces(self, x: Array) -> IntArray:
        """Return the piece of each partition in which a point (n,) lies, or the nearest one."""
        return np.array([p.find_piece(x) for p in self.partitions], np.int64)

    def build_integers(self, x: Array, pieces: IntArray | None = None) -> Array:
        """Return a vector (n',) to fix: the integers of x and those that select the pieces."""
        chosen = self.find_pieces(x) if pieces is None else pieces
        point = np.zeros(self.instance.size)
        point[: self.original_size] = x
        point[self.original_size : self.original_size + self.products.count] = self.products.values(
            x
        )
        for partition, delta, bits, i in zip(
            self.partitions, self.weights, self.bits, chosen, strict=True
        ):
            point[delta[i]] = 1.0
            point[bits] = build_code(partition.count)[i] if len(bits) else 0.0
        return point

    def lift(self, x: Array) -> Array:
        """Return the point (n',) of the relaxation for x (n,), with w the exact products.

        It satisfies all added rows if x lies in a piece of every partition. With secants, squares
        are off by the distance of the chord.
        """
        point = self.build_integers(x)
        chosen = self.find_pieces(x)
        for cell in self.cells:
            i, j = self.products.first[cell.product], self.products.second[cell.product]
            is_selected = np.ones(len(cell.ix), bool)
            for factor, number in ((cell.x, cell.ix), (cell.y, cell.iy)):
                if factor.partition >= 0:
                    is_selected &= number == chosen[factor.partition]
            cell_index = int(np.flatnonzero(is_selected)[0])
            corners = Corners(
                *(array[cell_index : cell_index + 1] for array in _split_corners(cell.corners))
            )
            weights = (
                compute_square_weights(corners, x[[i]])
                if i == j
                else compute_product_weights(corners, x[[i]], x[[j]])
            )
            V = weights.shape[1]
            point[cell.first_weight + cell_index * V + np.arange(V)] = weights[0]
        return point


@dataclass(frozen=True)
class McCormick(Reformulation[EnvelopedInstance]):
    """Piecewise envelopes on partitions.

    Attributes:
        partitions: Grids of factors.
        encoding: `unary` (one binary for each piece) or `log2`.
        squares: `envelope` (tangents and chord) or `secant` (the published chord, no relaxation).
        unbounded: `refuse`, or `open` to leave out planes that need a missing bound.
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
        """Build from intervals (N, 2) by variable index."""
        return cls(by_variable(grids), encoding, squares)

    def __post_init__(self) -> None:
        stated = np.concatenate([np.zeros(0, np.int64), *(p.variables for p in self.partitions)])
        if len(np.unique(stated)) != len(stated):
            raise UsageError("a variable stands in two partitions")

    def accepts(self, instance: Instance) -> bool:
        """Accept instances with the partitions' variables, and bounds on every other factor."""
        inside = all((p.variables < instance.size).all() for p in self.partitions)
        return inside and super().accepts(instance)

    def apply(self, instance: Instance) -> EnvelopedInstance:
        """Replace the products of an instance.

        Raises:
            UsageError: A factor has neither a partition nor bounds.
        """
        return self.form(instance).at(instance)

    def form(self, instance: Instance, is_late: Callable[[], bool] = lambda: False) -> EnvelopeForm:
        """Build everything that does not depend on the instance's rows, for many instances.

        Args:
            instance: The instance.
            is_late: Returns whether the time limit is reached.

        Raises:
            UsageError: A factor has neither a partition nor bounds.
            LimitReached: The time limit is reached.
        """
        box = compute_factor_bounds(instance, self.partitions, self.unbounded)
        low, high = box.lower, box.upper
        n, K = instance.size, instance.products.count
        rows = TripletRows()
        integer, deltas, bits = [], [], []
        column = n + K
        for partition in self.partitions:
            delta, z, is_binary = self._place_pieces(partition, column)
            column += len(is_binary)
            integer.append(is_binary)
            _append_piece_rows(rows, partition, delta, z)
            deltas.append(delta)
            bits.append(z)
        cells, without_partition = [], []
        places = self._locate_variables()
        for product in range(K):
            if is_late():
                raise LimitReached(
                    "the time limit ended before the envelopes were built; a larger limit or fewer "
                    "pieces (`envelopes.pieces`) may help"
                )
            product_cells = self._build_cells(instance.products, product, places, low, high, column)
            if product_cells is None:
                without_partition.append(product)
                continue
            _append_weight_rows(rows, product_cells, instance.products, n, deltas)
            integer.append(np.zeros(product_cells.corners.x.size, bool))
            column += product_cells.corners.x.size
            cells.append(product_cells)
        append_envelope_rows(
            rows, instance.products, np.array(without_partition, int), box, n, self.squares
        )
        extension = Extension(
            np.zeros(column - n - K),
            np.ones(column - n - K),
            np.concatenate([np.zeros(0, bool), *integer]),
            rows.matrix(column),
            rows.lower,
            rows.upper,
        )
        return EnvelopeForm(
            self.partitions,
            tuple(deltas),
            tuple(bits),
            tuple(cells),
            instance.products,
            extension,
            relaxation=self._is_relaxation(instance),
        )

    def _is_relaxation(self, instance: Instance) -> bool:
        """Return whether pieces cover all ranges and envelopes contain all products."""
        covering = all(
            p.covers(instance.lower[p.variables], instance.upper[p.variables])
            for p in self.partitions
        )
        square = instance.products.first == instance.products.second
        return bool(covering and (self.squares == "envelope" or not square.any()))

    def _locate_variables(self) -> dict[int, tuple[int, int]]:
        """Return the partition of each variable that has one, and its column there."""
        return {
            int(variable): (p, k)
            for p, partition in enumerate(self.partitions)
            for k, variable in enumerate(partition.variables)
        }

    def _place_pieces(
        self, partition: Partition, column: int
    ) -> tuple[IntArray, IntArray, BoolArray]:
        """Return the columns of weights and of their code from `column`, and which are binaries."""
        N, count = partition.count, partition.count_binaries(self.encoding)
        num_bits = count if self.encoding == "log2" else 0
        unary = self.encoding == "unary" and count > 0
        is_binary = np.concatenate([np.full(N, unary), np.ones(num_bits, bool)])
        return column + np.arange(N), column + N + np.arange(num_bits), is_binary

    def _build_cells(
        self,
        products: Products,
        product: int,
        places: dict[int, tuple[int, int]],
        low: Array,
        high: Array,
        column: int,
    ) -> _CellWeights | None:
        """Build the cells of one product, None if neither factor has a partition."""
        i, j = int(products.first[product]), int(products.second[product])
        x, y = (self._build_factor(variable, places, low, high) for variable in (i, j))
        if x.partition < 0 and y.partition < 0:
            return None
        if x.partition == y.partition:
            ix = iy = np.arange(len(x.lower))
        else:
            ix, iy = (
                array.ravel()
                for array in np.meshgrid(
                    np.arange(len(x.lower)), np.arange(len(y.lower)), indexing="ij"
                )
            )
        if i == j:
            corners = compute_square_corners(x.lower, x.upper, self.squares)
        else:
            corners = compute_product_corners(x.lower[ix], x.upper[ix], y.lower[iy], y.upper[iy])
        return _CellWeights(product, column, corners, x, y, ix, iy)

    def _build_factor(
        self, variable: int, places: dict[int, tuple[int, int]], low: Array, high: Array
    ) -> _Factor:
        """Return the ranges of one factor."""
        if variable not in places:
            return _Factor(-1, low[[variable]], high[[variable]])
        p, k = places[variable]
        partition = self.partitions[p]
        return _Factor(p, partition.lower[:, k], partition.upper[:, k])


@dataclass(frozen=True)
class EnvelopeForm:
    """The variables and rows that replace products, for instances with the same products."""

    partitions: tuple[Partition, ...]
    weights: tuple[IntArray, ...]
    bits: tuple[IntArray, ...]
    cells: tuple[_CellWeights, ...]
    products: Products
    extension: Extension
    relaxation: bool

    def at(self, instance: Instance) -> EnvelopedInstance:
        """Return the instance with its products replaced; its bounds must be those of the form."""
        linear = linearise_products(instance)
        return EnvelopedInstance(
            extend_instance(linear, self.extension),
            instance.size,
            self.relaxation,
            self.partitions,
            self.weights,
            self.bits,
            self.cells,
            self.products,
        )


def _split_corners(corners: Corners) -> tuple[Array, Array, Array]:
    """Return the coordinates of corners."""
    return corners.x, corners.y, corners.w


def _append_piece_rows(
    rows: TripletRows, partition: Partition, delta: IntArray, bits: IntArray
) -> None:
    """Append the rows that select a piece by delta, the code of delta, and the piece's ends."""
    rows.add(1, [(0, delta, 1.0)], 1.0, 1.0)
    if len(bits):
        bit, i = np.nonzero(build_code(len(delta)).T)
        entries = [(bit, delta[i], 1.0), (np.arange(len(bits)), bits, -1.0)]
        rows.add(len(bits), entries, 0.0, 0.0)
    for k, variable in enumerate(partition.variables):
        # The variable lies in its piece, whether products hold it there or not.
        variable_entry = [(0, variable, 1.0)]
        rows.add(1, [*variable_entry, (0, delta, -partition.lower[:, k])], 0.0, np.inf)
        rows.add(1, [*variable_entry, (0, delta, -partition.upper[:, k])], -np.inf, 0.0)


def _append_weight_rows(
    rows: TripletRows, cells: _CellWeights, products: Products, n: int, deltas: list[IntArray]
) -> None:
    """Append (x, y, w) = sum of weights times corners, and the sums of weights."""
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
