"""The ADMM split of chapter 6.4: a mixed-integer block and a nonlinear block in consensus.

The mixed-integer block keeps everything of the program but the exact products, for which it has
envelopes; the nonlinear block keeps the smooth rows and those with products, exact, and takes the
integers as the other block chose them. Each pulls its variables to those of the other, eq. (6.12).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.extension import Extension, extended
from climbplan.reformulations.mccormick import McCormick
from climbplan.reformulations.nlp_form import Bounds, Consensus, Manner, NlpForm, nlp_form

Norm = Literal["l1", "l2"]
Relaxation = Callable[[Instance], Reformulated]


@dataclass(frozen=True)
class SplitInstance:
    """Both blocks of an instance."""

    instance: Instance
    relaxed: Reformulated  # without products; its first variables are the instance's
    form: NlpForm  # of the nonlinear block
    span: Array  # (n,) of the variables' bounds, 1 where there are none: unit of residuals

    def mixed_integer(
        self, consensus: Consensus, norm: Norm = "l2", pinned: Array | None = None
    ) -> Instance:
        """The block of eq. (6.12a).

        norm: l2 adds weight (x - target)^2 to the cost; l1 adds weight |x - target| by one more
        variable each, which keeps a linear program linear. pinned: integers kept (n,).
        """
        block, extra = self.relaxed.instance, self.relaxed.instance.size - self.instance.size
        weight = np.concatenate([consensus.weight, np.zeros(extra)])
        target = np.concatenate([consensus.target, np.zeros(extra)])
        block = replace(
            block,
            P=sparse.csc_matrix(consensus.share * block.P),
            q=consensus.share * block.q,
            constant=consensus.share * block.constant,
        )
        if pinned is not None:
            fixed = np.flatnonzero(self.instance.integer)
            lower, upper = block.lower.copy(), block.upper.copy()
            lower[fixed] = upper[fixed] = np.round(pinned[fixed])
            block = replace(block, lower=lower, upper=upper)
        if norm == "l2":
            return replace(
                block,
                P=sparse.csc_matrix(block.P + sparse.diags(2 * weight)),
                q=block.q - 2 * weight * target,
                constant=block.constant + float(weight @ target**2),
            )
        pulled = np.flatnonzero(weight)
        count = len(pulled)
        unit = sparse.identity(block.size, format="csr")[pulled]
        distance = sparse.identity(count, format="csr")
        wide = extended(
            block,
            Extension(
                np.full(count, -np.inf),
                np.full(count, np.inf),
                np.zeros(count, bool),
                # distance >= x - target and distance >= target - x
                sparse.bmat([[-unit, distance], [unit, distance]]).tocsr(),
                np.concatenate([-target[pulled], target[pulled]]),
                np.full(2 * count, np.inf),
            ),
        )
        return replace(wide, q=np.concatenate([block.q, weight[pulled]]))

    def invert(self, x: Array) -> Array:
        """The statement's variables in a point (n',) of the mixed-integer block."""
        return self.relaxed.invert(x)

    def nonlinear_bounds(self, integers: Array, assignment: IntArray) -> Bounds:
        """Bounds of the block of eq. (6.12b) with the other block's integers."""
        return self.form.pinned_bounds(self.instance, integers, assignment)


@dataclass(frozen=True)
class AdmmSplit(Reformulation[SplitInstance]):
    """relax: envelopes of an instance's products, one piece each if left out."""

    relax: Relaxation = McCormick(unbounded="open").apply

    def apply(self, instance: Instance) -> SplitInstance:
        """Raises UsageError as `relax` does."""
        span = instance.upper - instance.lower
        return SplitInstance(
            instance=instance,
            relaxed=self.relax(replace(instance, smooth=None)),
            form=nlp_form(instance, Manner("pinned", only_products=True)),
            span=np.where(np.isfinite(span) & (span > 0), span, 1.0),
        )
