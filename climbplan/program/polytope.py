"""Polytopes, the alternatives of a disjunction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class Polytope:
    """The set {y in R^d : A y <= b, C y = c}, possibly unbounded."""

    name: str
    A: Array  # (m, d)
    b: Array  # (m,)
    C: Array  # (k, d)
    c: Array  # (k,)
    vertices: Array | None = None  # (V, d) if bounded and known: lets solvers tighten relaxations

    @classmethod
    def halfspaces(cls, name: str, A: Array, b: Array) -> Polytope:
        """Return {y : A y <= b}."""
        d = A.shape[1]
        return cls(name, A, b, np.zeros((0, d)), np.zeros(0))

    @property
    def dimension(self) -> int:
        """Dimension d."""
        return int(self.A.shape[1])

    def violation(self, y: Array) -> float:
        """Return the largest violation of a row at y (d,), 0 if y is inside."""
        worst = 0.0
        if len(self.b):
            worst = max(worst, float((self.A @ y - self.b).max()))
        if len(self.c):
            worst = max(worst, float(np.abs(self.C @ y - self.c).max()))
        return worst
