"""Check what a certificate proves of an instance.

The checker uses nothing of the solver that made the certificate. The box follows from the
instance's own rows, the tree's splits cover it in any case, and multipliers are evaluated with the
instance's own numbers in the box of their leaf. All arithmetic is rounded so that errors weaken
proofs. Bounds hold for every point that violates no row and no ball by more than `TOLERANCE`, and
satisfies bounds and integers exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.certificates.box import TOLERANCE, CertificateBox, tighten_box
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.lagrangian import build_lagrangian, compute_convexity_shift
from climbplan.certificates.rounding import round_down
from climbplan.certificates.rows import append_envelopes, build_stated_rows
from climbplan.errors import UsageError
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class CertificateVerdict:
    """The bound that is proved, and the faults of a certificate that proves nothing."""

    bound: float  # lower bound: infinite if nothing is feasible, -infinite if nothing is proved
    margin: float  # amount by which all rows may be relaxed without becoming feasible
    faults: tuple[str, ...]


def check(instance: Instance, certificate: Certificate) -> CertificateVerdict:
    """Check what a certificate proves; raise UsageError for unsupported statements."""
    checker, c = Checker(instance), certificate
    if faults := tuple(checker.find_faults(c)):
        return CertificateVerdict(-np.inf, 0.0, faults)
    bound, margin, stack, s = np.inf, np.inf, [checker.root], 0
    for j, value in zip(c.split, c.at, strict=True):
        if not stack:
            break
        box = tighten_box(checker.rows, stack.pop())
        if j >= 0:
            stack += reversed(box.bisect(checker.rows, j, value))
            continue
        point, y = None if c.empty[s] else c.point[s], c.multiplier[s].toarray().ravel()
        leaf_proof = checker.evaluate_leaf(box, point, y, c.ball[s])
        bound, margin, s = min(bound, leaf_proof[0]), min(margin, leaf_proof[1]), s + 1
    if stack or s < len(c.empty):
        return CertificateVerdict(
            -np.inf, 0.0, ("tree: its nodes are not those of one whole tree",)
        )
    return CertificateVerdict(bound, margin if bound == np.inf else 0.0, ())


class Checker:
    """Evaluates multipliers of an instance, leaf by leaf."""

    def __init__(self, instance: Instance) -> None:
        """Tighten the box of the root; raise UsageError for unsupported statements."""
        self.instance, self.rows = instance, build_stated_rows(instance)
        n, size = instance.size, len(self.rows.integer)
        lower, upper = np.zeros(size), np.ones(size)  # of z, while w is open
        lower[:n], upper[:n] = instance.lower, instance.upper
        lower[self.rows.w], upper[self.rows.w] = -np.inf, np.inf
        self.root = tighten_box(self.rows, CertificateBox(lower, upper), sweeps=100)
        factors = np.append(self.rows.first, self.rows.second)
        if not self.root.empty and np.isinf(self.root.upper - self.root.lower)[factors].any():
            raise UsageError(f"{instance.name}: expected bounds of every factor of a product")
        self._curvature = compute_convexity_shift(instance.P)

    def evaluate_leaf(
        self, box: CertificateBox, point: Array | None, y: Array, ball: Array
    ) -> tuple[float, float]:
        """Return bound and margin of a leaf; without a point it has to be proved infeasible."""
        if box.empty:
            return np.inf, TOLERANCE
        rows = append_envelopes(self.rows, box.lower, box.upper)
        total = build_lagrangian(self.instance, rows, box, point, y, ball)
        min_value = float(round_down(total.minimise(box) - 1.01 * TOLERANCE * total.weight))
        if point is None:
            return (np.inf, min_value / total.weight) if min_value > 0.0 else (-np.inf, 0.0)
        low, high = box.lower[: len(point)], box.upper[: len(point)]
        distance = np.where(self._curvature > 0.0, np.maximum(point - low, high - point), 0.0)
        return float(round_down(min_value - 0.51 * (self._curvature * distance**2).sum())), 0.0

    def find_faults(self, c: Certificate) -> Iterator[str]:
        """Yield faults of arrays: wrong shapes and infinite numbers."""
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
