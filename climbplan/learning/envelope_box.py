"""Envelopes: boxes of bilinear factors.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Envelope:
    """Box lower <= (p, f) <= upper of N limbs, with McCormick envelopes, eq. (8.26)."""

    lower: Array  # (N, d)
    upper: Array  # (N, d)

    def widen(self, fraction: float) -> Envelope:
        """Return the box with every side moved out by a fraction of its width."""
        margin = fraction * (self.upper - self.lower)
        return Envelope(self.lower - margin, self.upper + margin)

    def contains(self, points: Array, slack: float = 1e-9) -> BoolArray:
        """Return (n,) which of the points (n, N, d) lie in the box."""
        inside = (points >= self.lower - slack) & (points <= self.upper + slack)
        return np.asarray(inside.all(axis=(1, 2)))


EnvelopeSet = tuple[Envelope, ...]


# Returns for each set of envelopes whether the first stage is feasible on rows (n,). With several
# envelopes in a set, one of them suffices.
FirstStageLabels = Callable[[Sequence[EnvelopeSet], IntArray], list[BoolArray]]


def stack_envelopes(envelopes: EnvelopeSet) -> Envelope:
    """Stack a set into one array of boxes (E, N, d)."""
    return Envelope(np.stack([e.lower for e in envelopes]), np.stack([e.upper for e in envelopes]))


def unstack_envelopes(boxes: Envelope) -> EnvelopeSet:
    """Return the set of stacked boxes."""
    return tuple(Envelope(a, b) for a, b in zip(boxes.lower, boxes.upper, strict=True))


def compute_bounding_box(points: Array) -> Envelope:
    """Return the smallest box that contains points (n, N, d)."""
    return Envelope(points.min(axis=0), points.max(axis=0))
