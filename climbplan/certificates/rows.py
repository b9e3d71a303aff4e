"""All rows of an instance in one order, each with what it depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.errors import UsageError
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array

_HELD = frozenset({"integers", "implications", "choices", "balls"})


@dataclass(frozen=True)
class StatedRows:
    """lower <= G x <= upper, of all points or of those with an integer or an alternative.

    Rows of alternatives are the products of the alternative's and the choice's matrices in doubles.
    """

    G: sparse.csr_matrix  # (rows, n)
    lower: Array  # (rows,)
    upper: Array
    binary: Index  # (rows,) variable that decides, -1
    value: Index  # (rows,) of that variable where the row holds
    alternative: Index  # (rows,) number among all alternatives, -1
    choice: Index  # (R,) whose alternative each one is

    @property
    def count(self) -> int:
        """Rows."""
        return len(self.lower)


def stated_rows(instance: Instance) -> StatedRows:
    """Plain rows, then those of implications, then those of alternatives, each as stated.

    Raises UsageError for products and smooth rows, of which leaves prove nothing.
    """
    beyond = instance.features - _HELD
    if beyond:
        raise UsageError(f"{instance.name}: no certificate holds {' and '.join(sorted(beyond))}")
    implied, plain = instance.implications, len(instance.row_lower)
    G, lower, upper = [instance.A, implied.A], [instance.row_lower], [instance.row_upper]
    lower.append(implied.lower)
    upper.append(implied.upper)
    number = [np.full(plain + implied.count, -1)]
    choice: list[int] = []
    for k, stated in enumerate(instance.choices):
        for polytope in stated.alternatives:
            matrix = np.vstack([polytope.A, polytope.C])
            shift = matrix @ stated.e
            G.append(sparse.csr_matrix(sparse.csr_matrix(matrix) @ stated.E))
            lower.append(np.concatenate([np.full(len(polytope.b), -np.inf), polytope.c]) - shift)
            upper.append(np.concatenate([polytope.b, polytope.c]) - shift)
            number.append(np.full(len(matrix), len(choice)))
            choice.append(k)
    rest = sum(len(part) for part in number[1:])
    matrix = sparse.csr_matrix(sparse.vstack(G))
    matrix.eliminate_zeros()
    return StatedRows(
        G=matrix,
        lower=np.concatenate(lower),
        upper=np.concatenate(upper),
        binary=np.concatenate([np.full(plain, -1), implied.binary, np.full(rest, -1)]).astype(int),
        value=np.concatenate([np.zeros(plain), implied.value, np.zeros(rest)]).astype(int),
        alternative=np.concatenate(number).astype(int),
        choice=np.array(choice, np.int64),
    )
