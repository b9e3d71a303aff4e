"""The published `convex` method: one convex program with envelopes around a neighbour's point.

Every factor of a product keeps to a box about the neighbour's value; in it products are replaced
by their envelopes. Without refinement the answer holds the products only as well as the box is
small: the exact check decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import Range
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.reformulations.pinned import PinnedForm
from climbplan.solvers.convex.sessions import ConvexBackend, session

PIECES = 8  # of a factor's range, as published for angles and normals


@dataclass(frozen=True)
class EnvelopeAnswer:
    """The point of one convex program."""

    x: Array | None  # (n,)
    word: str


class EnvelopeSolver:
    """Candidates of one instance, each by one convex program.

    pieces: the box reaches one of as many equal pieces of a factor's bounds to either side of the
    neighbour's value. A fixed grid would put a value on the edge of its piece (sin 0) at one side.
    """

    def __init__(
        self, instance: Instance, backend: ConvexBackend = "daqp", pieces: int = PIECES
    ) -> None:
        self._pieces = pieces
        self._pinned = PinnedForm.of(instance)
        self._session = session(backend)
        products = instance.products
        self._factors = np.unique(np.concatenate([products.first, products.second]))

    def solve(self, values: Array, alternatives: IntArray, start: Array) -> EnvelopeAnswer:
        """Raises UsageError where a factor has no bounds."""
        pinned = self._pinned.at(values, alternatives)
        if (pinned.lower > pinned.upper).any():
            return EnvelopeAnswer(None, "contradiction")
        low, high = pinned.lower.copy(), pinned.upper.copy()
        k = self._factors
        reach = (high[k] - low[k]) / self._pieces
        if not np.isfinite(reach).all():
            raise UsageError(f"{pinned.name}: envelopes need bounds on all factors of products")
        middle = np.clip(start[k], low[k], high[k])
        low[k], high[k] = np.maximum(low[k], middle - reach), np.minimum(high[k], middle + reach)
        if not pinned.products.count:
            answer = self._session.solve(pinned)
        else:
            box = Range(low, high)
            answer = self._session.solve(LocalForm.of(pinned).at(box))
        if answer.x is None:
            return EnvelopeAnswer(None, "contradiction" if answer.infeasible else "failed")
        return EnvelopeAnswer(np.array(answer.x[: pinned.size]), "solved")
