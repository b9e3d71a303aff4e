"""All integers, implications and choices given: what is left is continuous.

With products left it is a small nonlinear program, without them a convex one: the online problem
of section 7.2.2.2. The matrices of a pinned instance are the same for all integers (unless a
product has an integer factor, which becomes linear); only bounds change, so that solvers keep
their factorisations and warm starts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance, Products
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.extension import no_implications


@dataclass(frozen=True)
class PinnedForm:
    """Every row that some choice of integers may demand, built once for an instance."""

    source: Instance
    A: sparse.csr_matrix  # (m, n) rows, implications, alternatives one after the other
    Q: sparse.csr_matrix  # (m, K)
    lower: Array  # (m,) where the row holds
    upper: Array  # (m,)
    always: int  # the first rows hold whatever the integers are
    choice: IntArray  # (a,) choice of each alternative's row
    alternative: IntArray  # (a,)

    @classmethod
    def of(cls, instance: Instance) -> PinnedForm:
        """Gather the rows of an instance."""
        implied = instance.implications
        A, lower, upper = [instance.A, implied.A], [instance.row_lower], [instance.row_upper]
        lower.append(implied.lower)
        upper.append(implied.upper)
        choice, alternative = [], []
        for c, group in enumerate(instance.choices):
            for r, polytope in enumerate(group.alternatives):
                A.append(sparse.csr_matrix(np.vstack([polytope.A, polytope.C])) @ group.E)
                equal = polytope.c - polytope.C @ group.e
                lower += [np.full(len(polytope.b), -np.inf), equal]
                upper += [polytope.b - polytope.A @ group.e, equal]
                choice.append(np.full(len(polytope.b) + len(equal), c))
                alternative.append(np.full(len(polytope.b) + len(equal), r))
        rows = sparse.vstack(A).tocsr()
        products = sparse.vstack([instance.Q, implied.Q]).tocsr()
        missing = rows.shape[0] - products.shape[0]
        return cls(
            source=instance,
            A=rows,
            Q=sparse.vstack([products, sparse.csr_matrix((missing, products.shape[1]))]).tocsr(),
            lower=np.concatenate(lower),
            upper=np.concatenate(upper),
            always=instance.A.shape[0],
            choice=np.concatenate([np.zeros(0, np.int64), *choice]).astype(np.int64),
            alternative=np.concatenate([np.zeros(0, np.int64), *alternative]).astype(np.int64),
        )

    def active(self, values: Array, alternatives: IntArray) -> BoolArray:
        """Which rows hold at the given integers, (m,)."""
        implied = self.source.implications.active(values)
        chosen = np.asarray(alternatives, np.int64)[self.choice] == self.alternative
        return np.concatenate([np.ones(self.always, bool), implied, chosen])

    def at(
        self, values: Array, alternatives: IntArray | None = None, compact: bool = False
    ) -> Instance:
        """The instance with integers at the rounded values (n,), of which only theirs are read.

        alternatives: chosen one of each choice. compact: leave out rows that do not hold instead
        of opening their bounds. Raises UsageError if alternatives are missing or integers not
        finite.
        """
        source = self.source
        if alternatives is None:
            alternatives = np.zeros(0, np.int64)
        if len(alternatives) != len(source.choices):
            raise UsageError(
                f"{source.name}: {len(source.choices)} alternatives to pin, "
                f"{len(alternatives)} given"
            )
        given = np.round(values[source.integer])
        if not np.isfinite(given).all():
            raise UsageError(f"{source.name}: an integer to pin is not a number")
        lower, upper = source.lower.copy(), source.upper.copy()
        # A value outside the variable's bounds leaves crossed bounds: infeasible, as it should.
        lower[source.integer] = np.maximum(lower[source.integer], given)
        upper[source.integer] = np.minimum(upper[source.integer], given)
        held = self.active(values, alternatives)
        A, Q, products = self._linear_products(values)
        row_lower = np.where(held, self.lower, -np.inf)
        row_upper = np.where(held, self.upper, np.inf)
        if compact:
            A, Q, row_lower, row_upper = A[held], Q[held], row_lower[held], row_upper[held]
        return replace(
            source,
            lower=lower,
            upper=upper,
            A=A,
            row_lower=row_lower,
            row_upper=row_upper,
            choices=(),
            integer=np.zeros(source.size, bool),
            products=products,
            Q=Q,
            implications=no_implications(source.size, products.count),
        )

    def _linear_products(
        self, values: Array
    ) -> tuple[sparse.csr_matrix, sparse.csr_matrix, Products]:
        """Products with an integer factor become linear in the other one."""
        products, integer = self.source.products, self.source.integer
        given = integer[products.first] | integer[products.second]
        if not given.any():
            return self.A, self.Q, products
        number = np.flatnonzero(given)
        swap = ~integer[products.first[number]]
        known = np.where(swap, products.second[number], products.first[number])
        other = np.where(swap, products.first[number], products.second[number])
        fold = sparse.csr_matrix(
            (np.round(values[known]), (number, other)),
            shape=(products.count, self.source.size),
        )
        A = (self.A + self.Q @ fold).tocsr()
        return A, self.Q[:, ~given], Products(products.first[~given], products.second[~given])


@dataclass(frozen=True)
class Pinned(Reformulation[Reformulated]):
    """Integers at `values` (n,), choices at `alternatives` (C,)."""

    values: Array
    alternatives: IntArray
    compact: bool = False

    @classmethod
    def at_point(cls, instance: Instance, x: Array) -> Pinned:
        """The integers that a point has or is nearest to."""
        return cls(x, instance.assignment(x))

    def accepts(self, instance: Instance) -> bool:
        """Any instance with as many variables and choices as are pinned."""
        return len(self.values) == instance.size and len(self.alternatives) == len(instance.choices)

    def apply(self, instance: Instance) -> Reformulated:
        """The continuous rest; use a `PinnedForm` to pin one instance many times."""
        pinned = PinnedForm.of(instance).at(self.values, self.alternatives, self.compact)
        return Reformulated(pinned, instance.size, relaxation=False)
