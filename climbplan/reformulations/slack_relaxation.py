"""Choices as sums of slacks: which alternative holds becomes a sparse vector's L1 norm.

SL1M (Tonneau, Song, Fernbach, Mansard, Taix, Del Prete: SL1M, ICRA 2020, arXiv 1909.04044) gives
every candidate surface r of a contact one slack alpha_r >= 0 that opens its rows,

    A_r y <= b_r + alpha_r,   -alpha_r <= C_r y - c_r <= alpha_r,

of which one has to be zero. That is a bound on the number of slacks that are not, and the L1 norm
sum alpha_r takes its place. No binaries are left and no big-M; what is left is convex.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Choice, Instance
from climbplan.program.polytope import Polytope
from climbplan.reformulations.base import Reformulated, Reformulation
from climbplan.reformulations.extension import Extension, RowStack, extended


@dataclass(frozen=True)
class Slackened(Reformulated):
    """An instance whose choices are rows with slacks, the sum of which is its cost."""

    slacks: tuple[IntArray, ...]  # columns of each choice, one an alternative; () for a single one

    def weighted(self, x: Array, near: float) -> Slackened:
        """The same with weights 1 / (alpha + near) at the slacks of x (n',).

        Candes, Wakin, Boyd: Enhancing Sparsity by Reweighted l1 Minimization (2008). near: in the
        unit of the rows, below which slacks count the same.
        """
        slacks = np.maximum(x[self.original_size :], 0.0)
        cost = np.concatenate([np.zeros(self.original_size), near / (slacks + near)])
        return replace(self, instance=replace(self.instance, q=cost))

    def of_choices(self, x: Array) -> list[Array]:
        """Slacks (R,) of each choice in a solution (n',), zero for one that has no other."""
        return [x[columns] if len(columns) else np.zeros(1) for columns in self.slacks]


@dataclass(frozen=True)
class SlackRelaxation(Reformulation[Slackened]):
    """Rows of alternatives with one slack each; the statement's own cost is left out.

    A choice with a single alternative keeps its rows as they are. Points of the instance are points
    of the form, so that where the form has none, neither has the instance.
    """

    def apply(self, instance: Instance) -> Slackened:
        """Any instance: integers, implications and products stay as they are."""
        rows, n = RowStack(), instance.size
        slacks: list[IntArray] = []
        count = 0
        for choice in instance.choices:
            several = len(choice.alternatives) > 1
            own = n + count + np.arange(len(choice.alternatives) if several else 0)
            for k, polytope in enumerate(choice.alternatives):
                _open(rows, choice, polytope, int(own[k]) if several else None)
            slacks.append(own.astype(np.int64))
            count += len(own)
        bare = replace(
            instance,
            choices=(),
            P=sparse.csc_matrix((n, n)),
            q=np.zeros(n),
            constant=0.0,
        )
        form = extended(
            bare,
            Extension(
                lower=np.zeros(count),
                upper=np.full(count, np.inf),
                integer=np.zeros(count, bool),
                A=rows.matrix(n + count),
                row_lower=rows.lower,
                row_upper=rows.upper,
            ),
        )
        form = replace(form, q=np.concatenate([np.zeros(n), np.ones(count)]))
        return Slackened(form, n, relaxation=True, slacks=tuple(slacks))


def _open(rows: RowStack, choice: Choice, polytope: Polytope, slack: int | None) -> None:
    """Rows of one alternative, opened by the slack of a column; as they are without."""
    for matrix, low, high in (
        (polytope.A, None, polytope.b),
        (polytope.C, polytope.c, polytope.c),
    ):
        here = sparse.coo_matrix(sparse.csr_matrix(matrix) @ choice.E)
        offset = matrix @ choice.e
        count = len(offset)
        for bound, sign in ((high, 1.0), (low, -1.0)):
            if bound is None or not count:
                continue
            entries: list[tuple[ArrayLike, ...]] = [(here.row, here.col, sign * here.data)]
            if slack is not None:
                entries.append((np.arange(count), slack, -1.0))
            rows.add(count, entries, -np.inf, sign * (bound - offset))
