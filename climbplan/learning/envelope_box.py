"""One envelope: a box of bilinear factors, and how well a set of them tells terrains apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Envelope:
    """lower <= (p, f) <= upper of N limbs; McCormick envelopes hold within, eq. (8.26)."""

    lower: Array  # (N, d)
    upper: Array  # (N, d)

    def grown(self, share: float) -> Envelope:
        """The box with every side moved out by a share of its width."""
        out = share * (self.upper - self.lower)
        return Envelope(self.lower - out, self.upper + out)

    def holds(self, points: Array, slack: float = 1e-9) -> BoolArray:
        """Which of the points (n, N, d) lie in the box, (n,)."""
        inside = (points >= self.lower - slack) & (points <= self.upper + slack)
        return np.asarray(inside.all(axis=(1, 2)))


EnvelopeSet = tuple[Envelope, ...]


# Whether the first stage has a solution on given rows, for each of some sets of envelopes: one (n,)
# a set. With several envelopes in a set, one of them is enough.
FirstStageLabels = Callable[[Sequence[EnvelopeSet], IntArray], list[BoolArray]]


def stacked(envelopes: EnvelopeSet) -> Envelope:
    """A set as one array of boxes (E, N, d)."""
    return Envelope(np.stack([e.lower for e in envelopes]), np.stack([e.upper for e in envelopes]))


def unstacked(boxes: Envelope) -> EnvelopeSet:
    """The set that `stacked` was made of."""
    return tuple(Envelope(a, b) for a, b in zip(boxes.lower, boxes.upper, strict=True))


def exterior(points: Array) -> Envelope:
    """The smallest box that holds points (n, N, d)."""
    return Envelope(points.min(axis=0), points.max(axis=0))
