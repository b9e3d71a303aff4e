"""What the exact check of a program reports, block by block."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BlockResidual:
    """Worst violation of one named block."""

    name: str
    residual: float  # 0 if satisfied; in `unit`
    unit: str
    index: tuple[int, ...]  # where in the block it is worst


@dataclass(frozen=True)
class CheckReport:
    """Worst violation of every block of a program at one point."""

    blocks: tuple[BlockResidual, ...]
    objective: float

    def worst(self) -> BlockResidual:
        """The block with the largest residual."""
        return max(self.blocks, key=lambda b: b.residual)

    def passed(self, tolerance: float) -> bool:
        """Whether no block is violated by more than the tolerance."""
        return all(b.residual <= tolerance for b in self.blocks)
