"""Whether a certificate proves what it says of an instance.

Nothing of the solver that made it is used. The box is what the instance's own rows leave, the
tree's splits cover it whatever they are, and multipliers are worth what the instance's own numbers
make of them in their leaf's box. All arithmetic is rounded so that errors make proofs weaker.
Bounds hold for every point that violates no row and no ball by more than `TOLERANCE`, bounds and
integers exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.certificates.box import TOLERANCE, Box, narrowed
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.lagrangian import curvature, lagrangian
from climbplan.certificates.rounding import down
from climbplan.certificates.rows import stated_rows, with_planes
from climbplan.errors import UsageError
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class Verdict:
    """What is proved, and what is wrong with the certificate if it proves nothing."""

    bound: float  # no feasible point costs less: infinite if there is none, -infinite if not proved
    margin: float  # of infeasibility: all rows may be let out by so much and nothing is feasible
    faults: tuple[str, ...]


def check(instance: Instance, certificate: Certificate) -> Verdict:
    """Everything that a certificate proves of an instance.

    Raises UsageError for statements beyond what certificates hold.
    """
    checker, c = Checker(instance), certificate
    if faults := tuple(checker.malformed(c)):
        return Verdict(-np.inf, 0.0, faults)
    bound, margin, waiting, s = np.inf, np.inf, [checker.root], 0
    for j, at in zip(c.split, c.at, strict=True):
        if not waiting:
            break
        box = narrowed(checker.rows, waiting.pop())
        if j >= 0:
            waiting += reversed(box.halves(checker.rows, j, at))
            continue
        point, y = None if c.empty[s] else c.point[s], c.multiplier[s].toarray().ravel()
        proved = checker.leaf(box, point, y, c.ball[s])
        bound, margin, s = min(bound, proved[0]), min(margin, proved[1]), s + 1
    if waiting or s < len(c.empty):
        return Verdict(-np.inf, 0.0, ("tree: its nodes are not those of one whole tree",))
    return Verdict(bound, margin if bound == np.inf else 0.0, ())


class Checker:
    """What multipliers prove of an instance, leaf by leaf."""

    def __init__(self, instance: Instance) -> None:
        """Raises UsageError for statements beyond what certificates hold."""
        self.instance, self.rows = instance, stated_rows(instance)
        n, size = instance.size, len(self.rows.integer)
        lower, upper = np.zeros(size), np.ones(size)  # of z, while w is open
        lower[:n], upper[:n] = instance.lower, instance.upper
        lower[self.rows.w], upper[self.rows.w] = -np.inf, np.inf
        self.root = narrowed(self.rows, Box(lower, upper), sweeps=100)
        factors = np.append(self.rows.first, self.rows.second)
        if not self.root.empty and np.isinf(self.root.upper - self.root.lower)[factors].any():
            raise UsageError(f"{instance.name}: nothing bounds a factor of a product")
        self._bend = curvature(instance.P)

    def leaf(self, box: Box, point: Array | None, y: Array, ball: Array) -> tuple[float, float]:
        """Bound and margin of a leaf; without a point its multipliers shall prove it empty."""
        if box.empty:
            return np.inf, TOLERANCE
        rows = with_planes(self.rows, box.lower, box.upper)
        total = lagrangian(self.instance, rows, box, point, y, ball)
        least = float(down(total.least(box) - 1.01 * TOLERANCE * total.weight))
        if point is None:
            return (np.inf, least / total.weight) if least > 0.0 else (-np.inf, 0.0)
        low, high = box.lower[: len(point)], box.upper[: len(point)]
        far = np.where(self._bend > 0.0, np.maximum(point - low, high - point), 0.0)
        return float(down(least - 0.51 * (self._bend * far**2).sum())), 0.0

    def malformed(self, c: Certificate) -> Iterator[str]:
        """Arrays that do not fit the instance, or that are not numbers."""
        nodes, leaves = len(c.split), int((c.split < 0).sum())
        rows = len(self.rows.lower) + 4 * len(self.rows.w)
        coordinates = sum(balls.f.size for balls in self.instance.balls)
        shapes = {
            "split": (nodes,), "at": (nodes,), "point": (leaves, self.instance.size),
            "multiplier": (leaves, rows), "ball": (leaves, coordinates), "empty": (leaves,),
        }  # fmt: skip
        for name, shape in shapes.items():
            array = getattr(c, name)
            numbers = array.data if name == "multiplier" else array
            if array.shape != shape:
                yield f"{name}: shape {shape} expected, got {array.shape}"
            elif not np.isfinite(numbers).all():
                yield f"{name}: finite numbers expected"
        if (c.split >= len(self.rows.integer)).any():
            yield f"split: variables below {len(self.rows.integer)} expected"
