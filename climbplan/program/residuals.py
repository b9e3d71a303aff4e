"""Results of the exact check of a program, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.deprecation import current_check_name
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
        """Return the block with the largest residual."""
        return max(self.blocks, key=lambda b: b.residual)

    def __getitem__(self, name: str) -> BlockResidual:
        """Return the block of a name at its worst; raises KeyError with the known names."""
        name = current_check_name(name, {block.name for block in self.blocks})
        blocks = [block for block in self.blocks if block.name == name]
        if not blocks:
            raise KeyError(f"no block {name!r}: {', '.join(sorted({b.name for b in self.blocks}))}")
        return max(blocks, key=lambda block: block.residual)

    def __str__(self) -> str:
        return "\n".join(map(str, self.blocks))

    def passed(self, tolerance: float) -> bool:
        """Return whether no block is violated by more than the tolerance."""
        return all(b.residual <= tolerance for b in self.blocks)


def check_blocks(
    blocks: Blocks, instance: Instance, x: Array, assignment: IntArray | None = None
) -> CheckReport:
    """Compute the residual of every block of the statement at x (n,).

    Args:
        blocks: Blocks of the statement.
        instance: Instance of the statement.
        x: (n,) point.
        assignment: Chosen alternative of each choice in order of statement, the least violated if
            missing.
    """
    chosen = instance.assignment(x) if assignment is None else assignment
    residuals = (
        *_check_bounds(blocks, x),
        *_check_rows(blocks, instance, x),
        *_check_balls(blocks, instance, x),
        *_check_implications(blocks, instance, x),
        *_check_choices(blocks, instance, x, chosen),
        *_check_smooth(blocks, instance, x),
    )
    return CheckReport(residuals, instance.objective(x))


def _check_bounds(blocks: Blocks, x: Array) -> Iterator[BlockResidual]:
    """Yield residuals of bounds and integrality."""
    for v in blocks.variables:
        values = x[v.start : v.stop].reshape(v.shape)
        yield find_worst_entry(
            f"bounds.{v.name}", compute_violation(values, v.lower, v.upper), v.unit
        )
        if v.integer:
            fraction = np.abs(values - np.round(values))
            yield find_worst_entry(f"integrality.{v.name}", fraction, v.unit)


def _check_rows(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    """Yield residuals of row blocks."""
    row = instance.A @ x + instance.Q @ instance.products.values(x)
    start = 0
    for rows in blocks.rows:
        span = slice(start, start + len(rows.expression))
        start = span.stop
        violation = compute_violation(row[span], instance.row_lower[span], instance.row_upper[span])
        yield find_worst_entry(rows.name, violation.reshape(rows.shape), rows.unit)


def _check_balls(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    """Yield residuals of ball blocks."""
    for block, balls in zip(blocks.balls, instance.balls, strict=True):
        excess = np.maximum(balls.excess(x), 0.0).reshape(block.shape)
        yield find_worst_entry(block.name, excess, block.unit)


def _check_implications(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    """Yield residuals of implications."""
    violation = instance.implications.violations(x, instance.products.values(x))
    start = 0
    for block in blocks.implications:
        span = slice(start, start + len(block.expression))
        start = span.stop
        yield find_worst_entry(block.name, violation[span].reshape(block.shape), block.unit)


def _check_choices(
    blocks: Blocks, instance: Instance, x: Array, chosen: IntArray
) -> Iterator[BlockResidual]:
    """Yield residuals of choices."""
    start = 0
    for group in blocks.choices:
        span = slice(start, start + len(group.alternatives))
        start = span.stop
        violation = np.array(
            [
                c.alternatives[k].violation(c.point(x))
                for c, k in zip(instance.choices[span], chosen[span], strict=True)
            ]
        )
        yield find_worst_entry(group.name, violation.reshape(group.shape), group.unit)


def _check_smooth(blocks: Blocks, instance: Instance, x: Array) -> Iterator[BlockResidual]:
    """Yield residuals of smooth blocks."""
    if instance.smooth is None:
        return
    violation = instance.smooth.outside(x)
    start = 0
    for block in blocks.smooth:
        span = slice(start, start + len(block.expression))
        start = span.stop
        yield find_worst_entry(block.name, violation[span].reshape(block.shape), block.unit)


def compute_violation(value: Array, lower: Array, upper: Array) -> Array:
    """Return how far values are below their lower or above their upper ends, 0 within."""
    return np.maximum(np.maximum(lower - value, value - upper), 0.0)


def find_worst_entry(name: str, residual: Array, unit: str) -> BlockResidual:
    """Return the largest residual of a block of any shape, and its index."""
    if residual.size == 0:
        return BlockResidual(name, 0.0, unit, ())
    flat = int(np.argmax(residual))
    index = tuple(int(i) for i in np.unravel_index(flat, residual.shape))
    return BlockResidual(name, float(residual.ravel()[flat]), unit, index)


@dataclass(frozen=True)
class RowNames:
    """Block of each of m rows."""

    names: tuple[str, ...]  # in the order in which blocks were begun
    units: tuple[str, ...]
    block: NDArray[np.int32]  # (m,)

    def residuals(self, violation: Array) -> tuple[BlockResidual, ...]:
        """Return the worst violation of each block from those of rows (m,).

        The index counts the block's rows.
        """
        return tuple(
            find_worst_entry(name, violation[self.block == number], unit)
            for number, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
        )
