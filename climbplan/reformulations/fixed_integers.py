"""Fix all integers, implications and choices: the rest is continuous.

With products it is a small nonlinear program, without them a convex one: the online problem of
section 7.2.2.2. Its matrices are the same for all integers (unless a product has an integer factor,
which makes it linear). Only bounds change, so solvers keep their factorisations and warm starts.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance, Products
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.extension import create_no_implications


@dataclass(frozen=True)
class FixedIntegerForm:
    """Every row that some assignment of integers may activate, built once for an instance."""

    source: Instance
    A: sparse.csr_matrix  # (m, n) rows, implications, alternatives one after the other
    Q: sparse.csr_matrix  # (m, K)
    lower: Array  # (m,) where the row is active
    upper: Array  # (m,)
    num_unconditional: int  # number of first rows, which are always active
    choice: IntArray  # (a,) choice of each alternative's row
    alternative: IntArray  # (a,)

    @classmethod
    def of(cls, instance: Instance) -> FixedIntegerForm:
        """Collect the rows of an instance."""
        implications = instance.implications
        A, lower, upper = [instance.A, implications.A], [instance.row_lower], [instance.row_upper]
        lower.append(implications.lower)
        upper.append(implications.upper)
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
        products = sparse.vstack([instance.Q, implications.Q]).tocsr()
        missing = rows.shape[0] - products.shape[0]
        return cls(
            source=instance,
            A=rows,
            Q=sparse.vstack([products, sparse.csr_matrix((missing, products.shape[1]))]).tocsr(),
            lower=np.concatenate(lower),
            upper=np.concatenate(upper),
            num_unconditional=instance.A.shape[0],
            choice=np.concatenate([np.zeros(0, np.int64), *choice]).astype(np.int64),
            alternative=np.concatenate([np.zeros(0, np.int64), *alternative]).astype(np.int64),
        )

    def find_active(self, values: Array, alternatives: IntArray) -> BoolArray:
        """Return the mask (m,) of rows that are active at the given integers."""
        active_implications = self.source.implications.active(values)
        chosen = np.asarray(alternatives, np.int64)[self.choice] == self.alternative
        return np.concatenate([np.ones(self.num_unconditional, bool), active_implications, chosen])

    def at(
        self, values: Array, alternatives: IntArray | None = None, compact: bool = False
    ) -> Instance:
        """Return the instance with integers fixed to the rounded values (n,).

        Args:
            values: (n,) point of which only the integers are read.
            alternatives: (C,) chosen alternative of each choice.
            compact: Whether to leave out inactive rows instead of opening their bounds.

        Raises:
            UsageError: Alternatives are missing, or integers are not finite.
        """
        source = self.source
        if alternatives is None:
            alternatives = np.zeros(0, np.int64)
        if len(alternatives) != len(source.choices):
            raise UsageError(
                f"{source.name}: {len(source.choices)} alternatives to pin, "
                f"{len(alternatives)} given"
            )
        integers = np.round(values[source.integer])
        if not np.isfinite(integers).all():
            raise UsageError(f"{source.name}: an integer to pin is not a number")
        lower, upper = source.lower.copy(), source.upper.copy()
        # A value outside the variable's bounds gives crossed bounds, hence infeasibility
        lower[source.integer] = np.maximum(lower[source.integer], integers)
        upper[source.integer] = np.minimum(upper[source.integer], integers)
        is_active = self.find_active(values, alternatives)
        A, Q, products = self._fold_products(values)
        row_lower = np.where(is_active, self.lower, -np.inf)
        row_upper = np.where(is_active, self.upper, np.inf)
        if compact:
            A, Q, row_lower, row_upper = (
                A[is_active],
                Q[is_active],
                row_lower[is_active],
                row_upper[is_active],
            )
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
            implications=create_no_implications(source.size, products.count),
        )

    def _fold_products(
        self, values: Array
    ) -> tuple[sparse.csr_matrix, sparse.csr_matrix, Products]:
        """Fold products with an integer factor into linear terms of the other factor."""
        products, integer = self.source.products, self.source.integer
        is_linear = integer[products.first] | integer[products.second]
        if not is_linear.any():
            return self.A, self.Q, products
        number = np.flatnonzero(is_linear)
        swap = ~integer[products.first[number]]
        fixed_factor = np.where(swap, products.second[number], products.first[number])
        free_factor = np.where(swap, products.first[number], products.second[number])
        fold = sparse.csr_matrix(
            (np.round(values[fixed_factor]), (number, free_factor)),
            shape=(products.count, self.source.size),
        )
        A = (self.A + self.Q @ fold).tocsr()
        return (
            A,
            self.Q[:, ~is_linear],
            Products(products.first[~is_linear], products.second[~is_linear]),
        )


@dataclass(frozen=True)
class FixedIntegers(Reformulation[Reformulated]):
    """Integers fixed to `values` (n,), choices to `alternatives` (C,)."""

    values: Array
    alternatives: IntArray
    compact: bool = False

    @classmethod
    def at_point(cls, instance: Instance, x: Array) -> FixedIntegers:
        """Fix the integers to those of a point, or the nearest ones."""
        return cls(x, instance.assignment(x))

    def accepts(self, instance: Instance) -> bool:
        """Accept any instance with as many variables and choices."""
        return len(self.values) == instance.size and len(self.alternatives) == len(instance.choices)

    def apply(self, instance: Instance) -> Reformulated:
        """Build the continuous rest; use `FixedIntegerForm` for many assignments."""
        fixed_instance = FixedIntegerForm.of(instance).at(
            self.values, self.alternatives, self.compact
        )
        return Reformulated(fixed_instance, instance.size, relaxation=False)
