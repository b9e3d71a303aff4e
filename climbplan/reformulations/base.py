"""What every reformulation of an instance into another instance offers."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.program.instance import Instance
from climbplan.program.polytope import Array


@dataclass(frozen=True)
class Reformulated:
    """An instance whose first variables are those of the one it came from."""

    instance: Instance
    original_size: int  # variables of the statement; the rest are auxiliary
    relaxation: bool  # its optimal value bounds the original's from below

    def invert(self, x: Array) -> Array:
        """The statement's variables in a solution (n',) of the reformulated instance."""
        return x[: self.original_size].copy()
