"""Choices relaxed to sums of slacks: the L1 norm selects the alternative that holds.

SL1M (Tonneau, Song, Fernbach, Mansard, Taix, Del Prete: SL1M, ICRA 2020, arXiv 1909.04044) gives
every candidate surface r of a contact one slack alpha_r >= 0 that relaxes its rows,

    A_r y <= b_r + alpha_r,   -alpha_r <= C_r y - c_r <= alpha_r,

of which one has to be zero. This cardinality constraint is replaced by the L1 norm sum alpha_r. The
result is convex, without binaries and big-M.
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
from climbplan.reformulations.extension import Extension, TripletRows, extend_instance


@dataclass(frozen=True)
class SlackForm(Reformulated):
    """An instance whose choices are rows with slacks, the sum of which is its cost."""

    slacks: tuple[IntArray, ...]  # columns of each choice's slacks; empty for one alternative

    def reweight(self, x: Array, weight_offset: float) -> SlackForm:
        """Return the form with weights 1 / (alpha + near) at the slacks of x (n',).

        `near` is the slack, in the unit of the rows, below which weights are equal (Candes, Wakin
        and Boyd, Enhancing Sparsity by Reweighted l1 Minimization, 2008).
        """
        slacks = np.maximum(x[self.original_size :], 0.0)
        cost = np.concatenate(
            [np.zeros(self.original_size), weight_offset / (slacks + weight_offset)]
        )
        return replace(self, instance=replace(self.instance, q=cost))

    def split_slacks(self, x: Array) -> list[Array]:
        """Return slacks (R,) of each choice in a solution (n',), zero for one without slacks."""
        return [x[columns] if len(columns) else np.zeros(1) for columns in self.slacks]


@dataclass(frozen=True)
class SlackRelaxation(Reformulation[SlackForm]):
    """Rows of alternatives with one slack each; the statement's own cost is left out.

    A choice with a single alternative keeps its rows. Points of the instance are points of the
    form, so an infeasible form proves that the instance is infeasible.
    """

    def apply(self, instance: Instance) -> SlackForm:
        """Relax the choices of any instance; integers, implications and products stay."""
        rows, n = TripletRows(), instance.size
        slacks: list[IntArray] = []
        count = 0
        for choice in instance.choices:
            has_slacks = len(choice.alternatives) > 1
            columns = n + count + np.arange(len(choice.alternatives) if has_slacks else 0)
            for k, polytope in enumerate(choice.alternatives):
                _append_relaxed_rows(
                    rows, choice, polytope, int(columns[k]) if has_slacks else None
                )
            slacks.append(columns.astype(np.int64))
            count += len(columns)
        without_choices = replace(
            instance,
            choices=(),
            P=sparse.csc_matrix((n, n)),
            q=np.zeros(n),
            constant=0.0,
        )
        form = extend_instance(
            without_choices,
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
        return SlackForm(form, n, relaxation=True, slacks=tuple(slacks))


def _append_relaxed_rows(
    rows: TripletRows, choice: Choice, polytope: Polytope, slack: int | None
) -> None:
    """Append the rows of one alternative, relaxed by the slack of a column if there is one."""
    for matrix, low, high in (
        (polytope.A, None, polytope.b),
        (polytope.C, polytope.c, polytope.c),
    ):
        entries_of_rows = sparse.coo_matrix(sparse.csr_matrix(matrix) @ choice.E)
        offset = matrix @ choice.e
        count = len(offset)
        for bound, sign in ((high, 1.0), (low, -1.0)):
            if bound is None or not count:
                continue
            entries: list[tuple[ArrayLike, ...]] = [
                (entries_of_rows.row, entries_of_rows.col, sign * entries_of_rows.data)
            ]
            if slack is not None:
                entries.append((np.arange(count), slack, -1.0))
            rows.add(count, entries, -np.inf, sign * (bound - offset))
