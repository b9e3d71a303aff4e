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

from climbplan.program.polytope import Array
from climbplan.solvers.branching import best_split, violations
from climbplan.solvers.certificate import proved_bound
from climbplan.solvers.components import SAME
from climbplan.solvers.dual_gains import row_rates
from climbplan.solvers.normal_form import Flags, NormalForm
from climbplan.solvers.relaxation import Point
from climbplan.solvers.result import Indices
from climbplan.solvers.row_pool import RowPool

_TOLERANCE = 1e-9
_VIOLATED = 1e-8  # a choice further than this from all its alternatives is branched on
_OPTIMAL = (1, 2, 4)
_INFEASIBLE = -1
_SAME_PRICE = 1e-10


@dataclass(frozen=True)
class BlockMinimum:
    """A lower bound on one part's minimum, and the best assignment found."""

    bound: float  # infinite if the part has no feasible point
    assignment: Indices | None  # alternatives of the part's choices, in order of `choices`
    price: Array  # h_b
    nodes: int


@dataclass(frozen=True)
class _Node:
    lower: Array  # bounds of all choice rows
    upper: Array
    allowed: Flags  # (C, R)


class Block:
    """One part of a normal form with at least one choice."""

    def __init__(self, form: NormalForm, pool: RowPool, part: int) -> None:
        self.form, self.pool, self.part = form, pool, part
        columns = np.flatnonzero(form.cost.part == part)
        self.columns = slice(int(columns[0]), int(columns[-1]) + 1)
        self.size = len(columns)
        self.choices = np.flatnonzero(_parts_of_choices(form) == part)
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

    def still_holds(self, known: BlockMinimum, price: Array, allowed: Flags) -> bool:
        """Whether a minimum found for more alternatives is the minimum for these as well."""
        if known.assignment is None:
            return False
        return bool(
            allowed[self.choices, known.assignment].all()
            and np.abs(known.price - price).max(initial=0.0) <= _SAME_PRICE
        )

    def minimum(
        self,
        price: Array,
        lower: Array,
        upper: Array,
        allowed: Flags,
        slack: float,
        limit: int,
        deadline: float,
        hint: Indices | None = None,
    ) -> BlockMinimum:
        """Branch and bound over the part alone.

        lower, upper: bounds of all choice rows. slack: a bound this close to the best point is
        good enough. limit, deadline: nodes and clock after which the best bound so far is
        returned. hint: a likely assignment of the part's choices.
        """
        form, base = self.form, self.form.choice_rows.start
        rows = np.flatnonzero(self.pool.part == self.part)
        M = np.ascontiguousarray(self.pool.M[rows, self.columns])
        low, high = self.pool.lower[rows], self.pool.upper[rows]
        chosen = np.flatnonzero((rows >= base) & (rows < form.choice_rows.stop))
        in_choice = rows[chosen] - base
        value = np.zeros(len(lower))
        best, best_assignment = np.inf, None
        proved = np.inf  # least bound of a node that was left
        nodes = 0
        root = _Node(lower, upper, allowed)
        heap: list[tuple[float, int, _Node]] = [(-np.inf, 0, root)]
        if hint is not None and allowed[self.choices, hint].all():
            heap.append((-np.inf, -1, self._fixed(root, hint)))
            heapq.heapify(heap)
        made = 1
        while heap and nodes < limit and time.perf_counter() < deadline:
            bound, kind, node = heapq.heappop(heap)
            if bound >= best - slack:
                proved = min(proved, bound)
                continue
            nodes += 1
            low[chosen], high[chosen] = node.lower[in_choice], node.upper[in_choice]
            sense = np.where(high - low <= SAME, 5, 0).astype(np.int32)
            z, _, flag, info = daqp.solve(
                self._identity, price, M, high, low, sense, primal_tol=_TOLERANCE
            )
            if flag == _INFEASIBLE:
                ceiling = self._ceiling(price)
                reached = proved_bound(price, M, low, high, np.zeros(self.size), ceiling)
                if reached >= ceiling:
                    continue
            elif flag in _OPTIMAL:
                reached = _dual_value(price, M, low, high, info["lam"])
            else:
                reached = -np.inf
            bound = max(bound, reached)
            if flag not in _OPTIMAL or bound >= best - slack:
                if kind >= 0:
                    proved = min(proved, bound)
                continue
            value[in_choice] = M[chosen] @ z
            off = violations(form, value, node.allowed)[self.choices]
            nearest = off.argmin(axis=1)
            violated = np.flatnonzero(off[np.arange(len(nearest)), nearest] > _VIOLATED)
            if not len(violated):
                if bound < best:
                    best, best_assignment = bound, nearest
                continue
            if kind < 0:
                continue
            split = best_split(form, value, self._rates, node.allowed, self.choices[violated])
            for mask, gain in zip(split.children, split.gains, strict=True):
                child = self._restricted(node, split.choice, mask)
                heapq.heappush(heap, (bound + float(gain), made, child))
                made += 1
        left = min((bound for bound, kind, _ in heap if kind >= 0), default=np.inf)
        return BlockMinimum(min(best, proved, left), best_assignment, price, nodes)

    def _ceiling(self, price: Array) -> float:
        """No feasible point of the part has more than this: the cost bounds |z|."""
        form = self.form
        radius = np.sqrt(2.0 * max(form.ceiling - form.cost.constant, 0.0))
        return float(0.5 * radius**2 + np.linalg.norm(price) * radius)

    def _restricted(self, node: _Node, choice: int, mask: int) -> _Node:
        form = self.form
        lower, upper, allowed = node.lower.copy(), node.upper.copy(), node.allowed.copy()
        base = form.choice_rows.start
        here = slice(form.start[choice] - base, form.start[choice + 1] - base)
        lower[here], upper[here] = form.hull(choice, mask)
        allowed[choice] = [bool(mask >> r & 1) for r in range(allowed.shape[1])]
        return _Node(lower, upper, allowed)

    def _fixed(self, node: _Node, assignment: Indices) -> _Node:
        for choice, r in zip(self.choices, assignment, strict=True):
            node = self._restricted(node, int(choice), 1 << int(r))
        return node


def _dual_value(price: Array, M: Array, lower: Array, upper: Array, multiplier: Array) -> float:
    held = np.flatnonzero(multiplier)
    m = multiplier[held]
    pull = price + m @ M[held]
    return float(-0.5 * pull @ pull - m @ np.where(m > 0, upper[held], lower[held]))


def _parts_of_choices(form: NormalForm) -> Indices:
    part = np.full(len(form.tables), -1)
    for group in form.groups:
        part[group.choices] = group.part
    return part


def blocks(form: NormalForm, pool: RowPool) -> list[Block]:
    """The parts with choices, without those fixed by equations or with flat coordinates."""
    with_choices = set(_parts_of_choices(form)) & set(form.cost.part)
    return [
        Block(form, pool, int(p))
        for p in sorted(with_choices - set(form.cost.part[form.cost.flat]))
    ]
