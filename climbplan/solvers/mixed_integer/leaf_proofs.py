"""What is known of leaves and what is written of them: proofs that the checker has accepted."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import sparse

from climbplan.arrays import IntArray
from climbplan.certificates.box import Box
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.checker import Checker
from climbplan.certificates.lagrangian import lagrangian
from climbplan.certificates.rows import StatedRows
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.telling import Multipliers


class Proved(NamedTuple):
    """What is written of a leaf."""

    bound: float
    multipliers: Multipliers


class LeafProofs:
    """Multipliers of leaves by what the checker makes of them."""

    def __init__(self, instance: Instance) -> None:
        """Raises UsageError for statements beyond what certificates hold."""
        self.instance, self.checker = instance, Checker(instance)
        self._choices = _choices(instance, self.checker.rows)

    def tried(self, rows: StatedRows, box: Box, found: Multipliers) -> Proved:
        """What multipliers prove of a leaf; rows: with the planes of its box."""
        evened = self._evened(rows, box, found)
        return Proved(self.checker.leaf(box, *evened)[0], evened)

    def nothing(self, box: Box) -> Multipliers:
        """No multipliers: what the box alone says."""
        n = self.instance.size
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (box.lower[:n] + box.upper[:n])
        coordinates = sum(balls.f.size for balls in self.instance.balls)
        rows = len(self.checker.rows.lower) + 4 * len(self.checker.rows.w)
        return Multipliers(
            np.where(np.isfinite(middle), middle, 0.0), np.zeros(rows), np.zeros(coordinates)
        )

    def _evened(self, rows: StatedRows, box: Box, found: Multipliers) -> Multipliers:
        """With multipliers that make the best alternative of each choice cost nothing more."""
        if not self._choices:
            return found
        slope = lagrangian(self.instance, rows, box, *found).slope
        y = found.rows.copy()
        for row, binaries in self._choices:
            allowed = binaries[box.upper[binaries] == 1.0]
            y[row] += slope[allowed].min() if len(allowed) else 0.0
        return found._replace(rows=y) if np.isfinite(y).all() else found


@dataclass
class Written:
    """A certificate's nodes in preorder, as far as they are written."""

    split: list[int] = field(default_factory=list)
    at: list[float] = field(default_factory=list)
    leaves: list[Proved] = field(default_factory=list)

    def add_split(self, variable: int, at: float) -> None:
        """A node with two sides, which have to follow."""
        self.split.append(variable)
        self.at.append(at)

    def add_leaf(self, proved: Proved) -> None:
        """A leaf."""
        self.add_split(-1, 0.0)
        self.leaves.append(proved)

    def certificate(self, instance: Instance) -> Certificate:
        """All of it; points are kept where the cost is curved."""
        found = [leaf.multipliers for leaf in self.leaves]
        n, curved = instance.size, np.diff(instance.P.indptr) > 0
        points = [np.zeros(n) if f.point is None else np.where(curved, f.point, 0.0) for f in found]
        return Certificate(
            split=np.array(self.split, np.int64),
            at=np.array(self.at),
            point=np.array(points),
            multiplier=sparse.csr_matrix(sparse.vstack([sparse.csr_matrix(f.rows) for f in found])),
            ball=np.array([f.ball for f in found]),
            empty=np.array([f.point is None for f in found]),
            bound=min(leaf.bound for leaf in self.leaves),
        )


def _choices(instance: Instance, rows: StatedRows) -> list[tuple[int, IntArray]]:
    """The row of each choice, and its binaries in v."""
    out, z = [], instance.size
    row = len(rows.lower) - sum(balls.f.size for balls in instance.balls) - len(instance.choices)
    for k, choice in enumerate(instance.choices):
        out.append((row + k, np.arange(z, z + len(choice.alternatives))))
        z += len(choice.alternatives)
    return out
