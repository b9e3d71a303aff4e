"""The method `convex` of X. Lin: one convex program with envelopes around a neighbour's point.

Every factor of a product is restricted to a box around the neighbour's value, in which products are
replaced by their McCormick envelopes. There is no refinement, so the accuracy of the products
depends on the size of the box; the exact check decides.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.fixed_integers import FixedIntegerForm
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.solvers.convex.sessions import ConvexBackend, create_session

PIECES = 8  # number of pieces of a factor's range, as published for angles and normals


@dataclass(frozen=True)
class EnvelopeAnswer:
    """The solution of one convex program."""

    x: Array | None  # (n,)
    word: str


class EnvelopeSolver:
    """Solves candidates of one instance, each by one convex program.

    The box reaches one of `pieces` equal pieces of a factor's bounds to either side of the
    neighbour's value. With a fixed grid a value could lie at an end of its piece (such as sin 0).
    """

    def __init__(
        self, instance: Instance, backend: ConvexBackend = "daqp", pieces: int = PIECES
    ) -> None:
        """Prepare the form with fixed integers of an instance and a session of the backend."""
        self._pieces = pieces
        self._fixed_form = FixedIntegerForm.of(instance)
        self._session = create_session(backend)
        products = instance.products
        self._factors = np.unique(np.concatenate([products.first, products.second]))

    def solve(self, values: Array, alternatives: IntArray, start: Array) -> EnvelopeAnswer:
        """Solve the convex program of one candidate.

        Args:
            values: (n,) point whose integers are fixed.
            alternatives: (C,) alternative of each choice.
            start: (n,) point around which the envelopes are built.

        Raises:
            UsageError: A factor has no bounds.
        """
        fixed_instance = self._fixed_form.at(values, alternatives)
        if (fixed_instance.lower > fixed_instance.upper).any():
            return EnvelopeAnswer(None, "contradiction")
        low, high = fixed_instance.lower.copy(), fixed_instance.upper.copy()
        factors = self._factors
        reach = (high[factors] - low[factors]) / self._pieces
        if not np.isfinite(reach).all():
            raise UsageError(
                f"{fixed_instance.name}: envelopes need bounds on all factors of products"
            )
        center = np.clip(start[factors], low[factors], high[factors])
        low[factors], high[factors] = (
            np.maximum(low[factors], center - reach),
            np.minimum(high[factors], center + reach),
        )
        if not fixed_instance.products.count:
            answer = self._session.solve(fixed_instance)
        else:
            box = ElementwiseRange(low, high)
            answer = self._session.solve(LocalForm.of(fixed_instance).at(box))
        if answer.x is None:
            return EnvelopeAnswer(None, "contradiction" if answer.infeasible else "failed")
        return EnvelopeAnswer(np.array(answer.x[: fixed_instance.size]), "solved")
