"""The ADMM split of chapter 6.4: a mixed-integer block and a nonlinear block in consensus.

The mixed-integer block keeps the whole program except the exact products, for which it has
envelopes. The nonlinear block keeps the smooth rows and those with products, exactly, with the
integers fixed by the other block. Each block is attracted to the variables of the other, eq.
(6.12).

Equation and chapter numbers are those of X. Lin (UCLA 2022).
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
from climbplan.reformulations.extension import Extension, extend_instance
from climbplan.reformulations.mccormick import McCormick
from climbplan.reformulations.nlp_form import Bounds, Consensus, NlpForm, NlpOptions, build_nlp_form

Norm = Literal["l1", "l2"]
Relaxation = Callable[[Instance], Reformulated]


@dataclass(frozen=True)
class SplitInstance:
    """Both blocks of an instance."""

    instance: Instance
    relaxed: Reformulated  # without products; its first variables are the instance's
    form: NlpForm  # of the nonlinear block
    span: Array  # (n,) width of the variables' bounds, 1 without bounds: unit of residuals

    def build_mixed_integer_block(
        self, consensus: Consensus, norm: Norm = "l2", integer_point: Array | None = None
    ) -> Instance:
        """Build the block of eq. (6.12a).

        Args:
            consensus: Weights and target.
            norm: l2 adds weight (x - target)^2 to the cost; l1 adds weight |x - target| with one
                more variable each, which keeps a linear program linear.
            integer_point: (n,) point whose integers are fixed.
        """
        block, num_auxiliary = (
            self.relaxed.instance,
            self.relaxed.instance.size - self.instance.size,
        )
        weight = np.concatenate([consensus.weight, np.zeros(num_auxiliary)])
        target = np.concatenate([consensus.target, np.zeros(num_auxiliary)])
        block = replace(
            block,
            P=sparse.csc_matrix(consensus.share * block.P),
            q=consensus.share * block.q,
            constant=consensus.share * block.constant,
        )
        if integer_point is not None:
            fixed = np.flatnonzero(self.instance.integer)
            lower, upper = block.lower.copy(), block.upper.copy()
            lower[fixed] = upper[fixed] = np.round(integer_point[fixed])
            block = replace(block, lower=lower, upper=upper)
        if norm == "l2":
            return replace(
                block,
                P=sparse.csc_matrix(block.P + sparse.diags(2 * weight)),
                q=block.q - 2 * weight * target,
                constant=block.constant + float(weight @ target**2),
            )
        weighted = np.flatnonzero(weight)
        count = len(weighted)
        unit = sparse.identity(block.size, format="csr")[weighted]
        distance = sparse.identity(count, format="csr")
        extended_block = extend_instance(
            block,
            Extension(
                np.full(count, -np.inf),
                np.full(count, np.inf),
                np.zeros(count, bool),
                # distance >= x - target and distance >= target - x
                sparse.bmat([[-unit, distance], [unit, distance]]).tocsr(),
                np.concatenate([-target[weighted], target[weighted]]),
                np.full(2 * count, np.inf),
            ),
        )
        return replace(extended_block, q=np.concatenate([block.q, weight[weighted]]))

    def invert(self, x: Array) -> Array:
        """Return the statement's variables in a point (n',) of the mixed-integer block."""
        return self.relaxed.invert(x)

    def compute_nonlinear_bounds(self, integers: Array, assignment: IntArray) -> Bounds:
        """Return bounds of the block of eq. (6.12b) with the other block's integers."""
        return self.form.compute_fixed_bounds(self.instance, integers, assignment)


@dataclass(frozen=True)
class AdmmSplit(Reformulation[SplitInstance]):
    """A split of instances; `relax` builds the envelopes of products, one piece by default."""

    relax: Relaxation = McCormick(unbounded="open").apply

    def apply(self, instance: Instance) -> SplitInstance:
        """Build both blocks.

        Raises:
            UsageError: `relax` does not accept the instance.
        """
        span = instance.upper - instance.lower
        return SplitInstance(
            instance=instance,
            relaxed=self.relax(replace(instance, smooth=None)),
            form=build_nlp_form(instance, NlpOptions("pinned", only_products=True)),
            span=np.where(np.isfinite(span) & (span > 0), span, 1.0),
        )
