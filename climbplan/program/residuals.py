"""What the exact check of a program reports, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.program.blocks import Blocks
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class BlockResidual:
    """Worst violation of one named block."""

    name: str
    residual: float  # 0 if satisfied; in `unit`
    unit: str
    index: tuple[int, ...]  # where in the block it is worst

    def __str__(self) -> str:
        return f"{self.name} off by {self.residual:.2g} {self.unit}".rstrip()


@dataclass(frozen=True)
class CheckReport:
    """Worst violation of every block of a program at one point."""

    blocks: tuple[BlockResidual, ...]
    objective: float

    def worst(self) -> BlockResidual:
        """The block with the largest residual."""
        return max(self.blocks, key=lambda b: b.residual)

    def __getitem__(self, name: str) -> BlockResidual:
        """The block of a name, at its worst; raises KeyError, which says what names there are."""
        found = [block for block in self.blocks if block.name == name]
        if not found:
            raise KeyError(f"no block {name!r}: {', '.join(sorted({b.name for b in self.blocks}))}")
        return max(found, key=lambda block: block.residual)

    def __str__(self) -> str:
        return "\n".join(map(str, self.blocks))

    def passed(self, tolerance: float) -> bool:
        """Whether no block is violated by more than the tolerance."""
        return all(b.residual <= tolerance for b in self.blocks)


def check_blocks(
    blocks: Blocks, instance: Instance, x: Array, assignment: IntArray | None = None
) -> CheckReport:
    """Residual of every block of the statement that an instance was made of, at x (n,).

    assignment: chosen alternative of each choice in order of statement; the least violated one
    if left out.
    """
    chosen = instance.assignment(x) if assignment is None else assignment
    found = (
        *_bounds(blocks, x),
        *_rows(blocks, instance, x),
        *_balls(blocks, instance, x),
        *_implications(blocks, instance, x),
        *_choices(blocks, instance, x, chosen),
        *_smooth(blocks, instance, x),
    )
    return CheckReport(found, instance.objective(x))


def _bounds(blocks: Blocks, x: Array) -> Iterator[BlockResidual]:
    for v in blocks.variables:
        values = x[v.start : v.stop].reshape(v.shape)
        yield worst_entry(f"bounds.{v.name}", outside(values, v.lower, v.upper), v.unit)
        if v.integer:
            fraction = np.abs(values - np.round(values))
            yield worst_entry(f"integrality.{v.name}", fraction, v.unit)


def _rows(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    row = instance.A @ x + instance.Q @ instance.products.values(x)
    start = 0
    for rows in blocks.rows:
        here = slice(start, start + len(rows.expression))
        start = here.stop
        off = outside(row[here], instance.row_lower[here], instance.row_upper[here])
        yield worst_entry(rows.name, off.reshape(rows.shape), rows.unit)


def _balls(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    for block, balls in zip(blocks.balls, instance.balls, strict=True):
        excess = np.maximum(balls.excess(x), 0.0).reshape(block.shape)
        yield worst_entry(block.name, excess, block.unit)


def _implications(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    failed = instance.implications.violations(x, instance.products.values(x))
    start = 0
    for implied in blocks.implications:
        here = slice(start, start + len(implied.expression))
        start = here.stop
        yield worst_entry(implied.name, failed[here].reshape(implied.shape), implied.unit)


def _choices(
    blocks: Blocks, instance: Instance, x: Array, chosen: IntArray
) -> Iterator[BlockResidual]:
    start = 0
    for group in blocks.choices:
        here = slice(start, start + len(group.alternatives))
        start = here.stop
        violation = np.array(
            [
                c.alternatives[k].violation(c.point(x))
                for c, k in zip(instance.choices[here], chosen[here], strict=True)
            ]
        )
        yield worst_entry(group.name, violation.reshape(group.shape), group.unit)


def _smooth(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    if instance.smooth is None:
        return
    outside = instance.smooth.outside(x)
    start = 0
    for block in blocks.smooth:
        here = slice(start, start + len(block.expression))
        start = here.stop
        yield worst_entry(block.name, outside[here].reshape(block.shape), block.unit)


def outside(value: Array, lower: Array, upper: Array) -> Array:
    """How far values are below their lower or above their upper ends, 0 within."""
    return np.maximum(np.maximum(lower - value, value - upper), 0.0)


def worst_entry(name: str, residual: Array, unit: str) -> BlockResidual:
    """The largest residual of a block, of any shape, and where it is."""
    if residual.size == 0:
        return BlockResidual(name, 0.0, unit, ())
    flat = int(np.argmax(residual))
    index = tuple(int(i) for i in np.unravel_index(flat, residual.shape))
    return BlockResidual(name, float(residual.ravel()[flat]), unit, index)


@dataclass(frozen=True)
class RowNames:
    """Which block each of m rows belongs to."""

    names: tuple[str, ...]  # in the order in which blocks were begun
    units: tuple[str, ...]
    block: NDArray[np.int32]  # (m,)

    def residuals(self, off: Array) -> tuple[BlockResidual, ...]:
        """Worst of each block, of what rows (m,) are off by; the index counts the block's rows."""
        return tuple(
            worst_entry(name, off[self.block == number], unit)
            for number, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
        )
