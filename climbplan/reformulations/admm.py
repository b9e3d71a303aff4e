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

from climbplan.program.box import product_range
from climbplan.program.instance import Balls, Choice, Index, Instance, Products
from climbplan.program.polytope import Array
from climbplan.reformulations.base import Reformulated
from climbplan.reformulations.nlp_form import Bounds, Consensus, Manner, NlpForm, nlp_form

Norm = Literal["l1", "l2"]
Relaxation = Callable[[Instance], Reformulated]


@dataclass(frozen=True)
class AdmmSplit:
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
        wide = _widened(block, len(pulled))
        unit = sparse.identity(block.size, format="csr")[pulled]
        distance = sparse.identity(len(pulled), format="csr")
        # distance >= x - target and distance >= target - x
        rows = sparse.bmat([[-unit, distance], [unit, distance]]).tocsr()
        return replace(
            _with_rows(
                wide,
                rows,
                np.concatenate([-target[pulled], target[pulled]]),
                np.full(2 * len(pulled), np.inf),
            ),
            q=np.concatenate([block.q, weight[pulled]]),
        )

    def nonlinear_bounds(self, integers: Array, assignment: Index) -> Bounds:
        """Bounds of the block of eq. (6.12b) with the other block's integers."""
        return self.form.pinned_bounds(self.instance, integers, assignment)


def admm_split(instance: Instance, relax: Relaxation | None = None) -> AdmmSplit:
    """Split an instance; relax: envelopes of its products, one piece each if left out."""
    relaxed = (relax or single_envelopes)(replace(instance, smooth=None))
    span = instance.upper - instance.lower
    return AdmmSplit(
        instance=instance,
        relaxed=relaxed,
        form=nlp_form(instance, Manner("pinned", only_products=True)),
        span=np.where(np.isfinite(span) & (span > 0), span, 1.0),
    )


def single_envelopes(instance: Instance) -> Reformulated:
    """Products as variables within McCormick's four planes over the bounds, squares within three.

    A plane that needs a missing bound is left out.
    """
    n, K = instance.size, instance.products.count
    first, second = instance.products.first, instance.products.second
    low, high = instance.lower, instance.upper
    reach = product_range(low, high, first, second)
    wide = _widened(instance, K)
    wide = replace(
        wide,
        A=sparse.hstack([instance.A, instance.Q]).tocsr(),
        Q=sparse.csr_matrix((instance.A.shape[0], 0)),
        products=Products(first[:0], second[:0]),
        implications=replace(
            instance.implications,
            A=sparse.hstack([instance.implications.A, instance.implications.Q]).tocsr(),
            Q=sparse.csr_matrix((instance.implications.count, 0)),
        ),
        lower=np.concatenate([low, reach.lower]),
        upper=np.concatenate([high, reach.upper]),
    )
    rows, lower, upper = [], [], []
    k = np.arange(K)
    ends = ((low, low, True), (high, high, True), (low, high, False), (high, low, False))
    for one, other, below in ends:
        a, b = one[first], other[second]
        kept = np.isfinite(a) & np.isfinite(b)
        # w - b x - a y + a b is at least 0 for equal ends, at most 0 for opposite ones
        entries = np.concatenate([np.ones(K), -b, -a])
        place = (np.tile(k, 3), np.concatenate([n + k, first, second]))
        wanted = np.tile(kept, 3)
        plane = sparse.coo_matrix(
            (entries[wanted], (place[0][wanted], place[1][wanted])), shape=(K, n + K)
        )
        rows.append(plane.tocsr()[kept])
        offset = -(a[kept] * b[kept])
        lower.append(offset if below else np.full(len(offset), -np.inf))
        upper.append(np.full(len(offset), np.inf) if below else offset)
    stacked = sparse.vstack(rows).tocsr()
    enveloped = _with_rows(wide, stacked, np.concatenate(lower), np.concatenate(upper))
    return Reformulated(enveloped, n, relaxation=True)


def _widened(instance: Instance, count: int) -> Instance:
    """The instance with further continuous variables that appear nowhere yet."""

    def wide(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
        return sparse.hstack([matrix, sparse.csr_matrix((matrix.shape[0], count))]).tocsr()

    return replace(
        instance,
        P=sparse.block_diag([instance.P, sparse.csc_matrix((count, count))]).tocsc(),
        q=np.concatenate([instance.q, np.zeros(count)]),
        lower=np.concatenate([instance.lower, np.full(count, -np.inf)]),
        upper=np.concatenate([instance.upper, np.full(count, np.inf)]),
        A=wide(instance.A),
        balls=tuple(Balls(wide(b.F), b.f, b.radius) for b in instance.balls),
        choices=tuple(Choice(c.name, wide(c.E), c.e, c.alternatives) for c in instance.choices),
        integer=np.concatenate([instance.integer, np.zeros(count, bool)]),
        implications=replace(instance.implications, A=wide(instance.implications.A)),
    )


def _with_rows(instance: Instance, rows: sparse.csr_matrix, lower: Array, upper: Array) -> Instance:
    empty = sparse.csr_matrix((rows.shape[0], instance.Q.shape[1]))
    return replace(
        instance,
        A=sparse.vstack([instance.A, rows]).tocsr(),
        row_lower=np.concatenate([instance.row_lower, lower]),
        row_upper=np.concatenate([instance.row_upper, upper]),
        Q=sparse.vstack([instance.Q, empty]).tocsr(),
    )
