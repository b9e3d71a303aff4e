"""Lagrangian bounds: the disjunctive minimum of each part while rows that couple parts are priced.

With multipliers l of the coupling rows the Lagrangian separates into the parts b of the instance,
V_b = min 1/2 |z_b|^2 + h_b'z_b over the part's own rows and choices, h_b = (M'l)_b. A relaxation
takes the same minima over the hulls of the choices, so each part's exact V_b raises its bound by
V_b minus the relaxed minimum. Parts are small (one limb's toes), and exact minima of them take a
few tiny QPs; their minimisers together are a good guess for the whole.
"""

from __future__ import annotations

import heapq
import time
from dataclasses import dataclass

import daqp
import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.tree.branching import best_split, violations
from climbplan.solvers.tree.certificate import proved_bound
from climbplan.solvers.tree.components import SAME
from climbplan.solvers.tree.dual_gains import row_rates
from climbplan.solvers.tree.normal_form import Masks, NormalForm
from climbplan.solvers.tree.relaxation import Point
from climbplan.solvers.tree.row_pool import RowPool

_TOLERANCE = 1e-9
_VIOLATED = 1e-8  # a choice further than this from all its alternatives is branched on
_OPTIMAL = (1, 2, 4)
_INFEASIBLE = -1
_SAME_PRICE = 1e-10


@dataclass(frozen=True)
class BlockMinimum:
    """A lower bound on one part's minimum, and the best assignment found."""

    bound: float  # infinite if the part has no feasible point
    assignment: IntArray | None  # alternatives of the part's choices, in order of `choices`
    price: Array  # h_b
    nodes: int


class Block:
    """One part of a normal form with at least one choice."""

    def __init__(self, form: NormalForm, pool: RowPool, part: int) -> None:
        self.form, self.pool, self.part = form, pool, part
        columns = np.flatnonzero(form.cost.part == part)
        self.columns = slice(int(columns[0]), int(columns[-1]) + 1)
        self.size = len(columns)
        self.choices = np.flatnonzero(form.choice_part == part)
        self.groups = [group for group in form.groups if group.part == part]
        self._identity = np.eye(self.size)
        rows = form.rows[form.choice_rows]
        none = np.zeros((0, form.size))
        self._rates = row_rates(
            rows, none, none[:, 0], none[:, 0] > 0, np.zeros(form.size), form.cost
        )

    def price(self, point: Point) -> Array:
        """h_b of a relaxation's multipliers."""
        coupling = self.pool.part[point.active] < 0
        rows = self.pool.M[point.active[coupling], self.columns]
        return np.asarray(point.multiplier[coupling] @ rows)

    def relaxed(self, point: Point, lower: Array, upper: Array) -> float:
        """The part's share of a relaxation's bound: -1/2 |z_b|^2 - l'b over its own active rows."""
        own = self.pool.part[point.active] == self.part
        active, multiplier = point.active[own], point.multiplier[own]
        at = np.where(multiplier > 0, upper[active], lower[active])
        pull = point.multiplier @ self.pool.M[point.active, self.columns]
        return float(-0.5 * pull @ pull - multiplier @ at)

    def still_holds(self, known: BlockMinimum, price: Array, masks: Masks) -> bool:
        """Whether a minimum found for more alternatives is the minimum for these as well."""
        if known.assignment is None:
            return False
        return bool(
            self._allows(masks, known.assignment)
            and np.abs(known.price - price).max(initial=0.0) <= _SAME_PRICE
        )

    def _allows(self, masks: Masks, assignment: IntArray) -> bool:
        chosen = zip(self.choices, assignment, strict=True)
        return all(masks[c] >> int(r) & 1 for c, r in chosen)

    def minimum(
        self,
        price: Array,
        masks: Masks,
        slack: float,
        limit: int,
        deadline: float,
        hint: IntArray | None = None,
    ) -> BlockMinimum:
        """Branch and bound over the part alone.

        masks: allowed alternatives of all choices. slack: a bound this close to the best point is
        good enough. limit, deadline: nodes and clock after which the best bound so far is
        returned. hint: a likely assignment of the part's choices.
        """
        form, base = self.form, self.form.choice_rows.start
        rows = np.flatnonzero((self.pool.part == self.part) & ~self.pool.is_own)
        M = np.ascontiguousarray(self.pool.M[rows, self.columns])
        low, high = self.pool.lower[rows], self.pool.upper[rows]
        in_choice = form.rows_of(self.choices)
        chosen = np.searchsorted(rows, in_choice)
        in_choice = in_choice - base
        value, whole = np.zeros(form.choice_rows.stop - base), np.zeros(form.size)
        best, best_assignment = np.inf, None
        proved = np.inf  # least bound of a node that was left
        nodes = 0
        heap: list[tuple[float, int, Masks]] = [(-np.inf, 0, masks)]
        if hint is not None and self._allows(masks, hint):
            fixed = list(masks)
            for c, r in zip(self.choices, hint, strict=True):
                fixed[c] = 1 << int(r)
            heap.append((-np.inf, -1, tuple(fixed)))
            heapq.heapify(heap)
        made = 1
        while heap and nodes < limit and time.perf_counter() < deadline:
            bound, kind, node = heapq.heappop(heap)
            if bound >= best - slack:
                proved = min(proved, bound)
                continue
            nodes += 1
            sets = tuple(node[c] for c in self.choices)
            low[chosen], high[chosen] = form.bounds_of(self.choices, sets)
            all_rows, lower, upper = self._with_own_rows(M, low, high, node)
            sense = np.where(upper - lower <= SAME, 5, 0).astype(np.int32)
            z, _, flag, info = daqp.solve(
                self._identity, price, all_rows, upper, lower, sense, primal_tol=_TOLERANCE
            )
            if flag == _INFEASIBLE:
                ceiling = self._ceiling(price)
                reached = proved_bound(price, all_rows, lower, upper, np.zeros(self.size), ceiling)
                if reached >= ceiling:
                    continue
            elif flag in _OPTIMAL:
                reached = _dual_value(price, all_rows, lower, upper, info["lam"])
            else:
                reached = -np.inf
            bound = max(bound, reached)
            if flag not in _OPTIMAL or bound >= best - slack:
                if kind >= 0:
                    proved = min(proved, bound)
                continue
            value[in_choice] = M[chosen] @ z
            whole[self.columns] = z
            allowed = form.flags(node)
            off = violations(form, whole, value, allowed, self.groups)[self.choices]
            nearest = off.argmin(axis=1)
            least = off[np.arange(len(nearest)), nearest]
            violated = np.flatnonzero(least > _VIOLATED)
            if not len(violated):
                if bound < best:
                    best, best_assignment = bound, nearest
                continue
            if kind < 0:
                continue
            worst = violated[np.argsort(-least[violated], kind="stable")]
            split = best_split(form, value, self._rates, node, self.choices[worst])
            for mask, gain in zip(split.children, split.gains, strict=True):
                child = (*node[: split.choice], mask, *node[split.choice + 1 :])
                heapq.heappush(heap, (bound + float(gain), made, child))
                made += 1
        left = min((bound for bound, kind, _ in heap if kind >= 0), default=np.inf)
        return BlockMinimum(min(best, proved, left), best_assignment, price, nodes)

    def _with_own_rows(
        self, M: Array, low: Array, high: Array, masks: Masks
    ) -> tuple[Array, Array, Array]:
        """Rows and bounds with what single alternatives of the part's choices state."""
        form = self.form
        made = [
            form.own_rows(int(c), masks[c].bit_length() - 1)
            for c in self.choices
            if not form.tables[c].complete and masks[c] & (masks[c] - 1) == 0
        ]
        if not made:
            return M, low, high
        rows = [np.ascontiguousarray(own.rows[:, self.columns]) for own in made]
        return (
            np.concatenate([M, *rows]),
            np.concatenate([low, *(own.lower for own in made)]),
            np.concatenate([high, *(own.upper for own in made)]),
        )

    def _ceiling(self, price: Array) -> float:
        """No feasible point of the part has more than this: the cost bounds |z|."""
        form = self.form
        radius = np.sqrt(2.0 * max(form.ceiling - form.cost.constant, 0.0))
        return float(0.5 * radius**2 + np.linalg.norm(price) * radius)


def _dual_value(price: Array, M: Array, lower: Array, upper: Array, multiplier: Array) -> float:
    held = np.flatnonzero(multiplier)
    m = multiplier[held]
    pull = price + m @ M[held]
    return float(-0.5 * pull @ pull - m @ np.where(m > 0, upper[held], lower[held]))


def blocks(form: NormalForm, pool: RowPool) -> list[Block]:
    """The parts with choices, without those fixed by equations or with flat coordinates."""
    with_choices = set(form.choice_part) & set(form.cost.part)
    return [
        Block(form, pool, int(p))
        for p in sorted(with_choices - set(form.cost.part[form.cost.flat]))
    ]
