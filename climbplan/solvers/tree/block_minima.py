"""Lagrangian bounds: the disjunctive minimum of each component with coupling rows priced.

With multipliers l of the coupling rows the Lagrangian separates into the components b of the
instance (Lagrangian decomposition),

    V_b = min 1/2 |z_b|^2 + h_b'z_b over the component's own rows and choices, h_b = (M'l)_b.

A relaxation takes the same minima over the hulls of the choices. Each component's exact V_b
therefore raises its bound by V_b minus the relaxed minimum. Components are small (one limb's toes),
and exact minima of them take a few tiny QPs; their minimisers together are a good primal heuristic.
"""

from __future__ import annotations

import heapq
import time
from dataclasses import dataclass

import daqp
import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.tree.branching import compute_violations, select_split
from climbplan.solvers.tree.certificate import compute_farkas_bound
from climbplan.solvers.tree.components import SAME
from climbplan.solvers.tree.dual_gains import compute_dual_steps
from climbplan.solvers.tree.normal_form import Masks, NormalForm
from climbplan.solvers.tree.relaxation import RelaxationPoint
from climbplan.solvers.tree.row_pool import RowPool

_TOLERANCE = 1e-9
_VIOLATED = 1e-8  # violation of all alternatives from which a choice is branched on
_OPTIMAL = (1, 2, 4)
_INFEASIBLE = -1
_SAME_PRICE = 1e-10


@dataclass(frozen=True)
class ComponentMinimum:
    """A lower bound on one component's minimum, and the best assignment found."""

    bound: float  # infinite if the component has no feasible point
    assignment: IntArray | None  # alternatives of the component's choices, in order of `choices`
    price: Array  # h_b
    nodes: int


@dataclass(frozen=True)
class _ComponentRows:
    """A component's rows lower <= M z <= upper, whose bounds a node rewrites, and a point."""

    M: Array  # (m, k)
    lower: Array  # (m,)
    upper: Array  # (m,)
    chosen: IntArray  # rows of the component's choices
    in_choice: IntArray  # the same rows among those of all choices
    value: Array  # values of the rows of all choices
    z: Array  # (size,) point in all coordinates, zero in those of other components


class ComponentProblem:
    """One component of a normal form with at least one choice."""

    def __init__(self, form: NormalForm, pool: RowPool, component: int) -> None:
        """Select columns and choices of the component."""
        self.form, self.pool, self.component = form, pool, component
        columns = np.flatnonzero(form.cost.component == component)
        self.columns = slice(int(columns[0]), int(columns[-1]) + 1)
        self.size = len(columns)
        self.choices = np.flatnonzero(form.choice_component == component)
        self.groups = [group for group in form.groups if group.component == component]
        self._identity = np.eye(self.size)
        rows = form.rows[form.choice_rows]
        no_rows = np.zeros((0, form.size))
        self._rates = compute_dual_steps(
            rows, no_rows, no_rows[:, 0], no_rows[:, 0] > 0, np.zeros(form.size), form.cost
        )

    def compute_price(self, point: RelaxationPoint) -> Array:
        """Return h_b for a relaxation's multipliers."""
        coupling = self.pool.component[point.active] < 0
        rows = self.pool.M[point.active[coupling], self.columns]
        return np.asarray(point.multiplier[coupling] @ rows)

    def compute_relaxed_value(self, point: RelaxationPoint, lower: Array, upper: Array) -> float:
        """Return the component's contribution to a relaxation's bound.

        It is -1/2 |z_b|^2 - l'b over the component's own active rows.
        """
        is_own = self.pool.component[point.active] == self.component
        active, multiplier = point.active[is_own], point.multiplier[is_own]
        right_side = np.where(multiplier > 0, upper[active], lower[active])
        gradient = point.multiplier @ self.pool.M[point.active, self.columns]
        return float(-0.5 * gradient @ gradient - multiplier @ right_side)

    def is_reusable(self, minimum: ComponentMinimum, price: Array, masks: Masks) -> bool:
        """Return whether a minimum found for more alternatives is the minimum for these as well."""
        if minimum.assignment is None:
            return False
        return bool(
            self._allows(masks, minimum.assignment)
            and np.abs(minimum.price - price).max(initial=0.0) <= _SAME_PRICE
        )

    def _allows(self, masks: Masks, assignment: IntArray) -> bool:
        """Return whether sets of alternatives allow an assignment."""
        chosen = zip(self.choices, assignment, strict=True)
        return all(masks[c] >> int(r) & 1 for c, r in chosen)

    def minimise(
        self,
        price: Array,
        masks: Masks,
        slack: float,
        limit: int,
        deadline: float,
        hint: IntArray | None = None,
    ) -> ComponentMinimum:
        """Minimise over the component alone by branch and bound.

        Args:
            price: Linear cost h_b.
            masks: Allowed alternatives of all choices.
            slack: Distance from the best point at which a bound suffices.
            limit: Largest number of nodes.
            deadline: Time of `time.perf_counter` [s]; at a limit the best bound so far is returned.
            hint: Likely assignment of the component's choices.
        """
        rows = self._select_rows()
        best, best_assignment = np.inf, None
        closed_bound = np.inf  # least bound of closed nodes
        nodes, num_created = 0, 1
        heap: list[tuple[float, int, Masks]] = [(-np.inf, 0, masks)]
        if hint is not None and self._allows(masks, hint):
            heapq.heappush(heap, (-np.inf, -1, self._fix_choices(masks, hint)))
        while heap and nodes < limit and time.perf_counter() < deadline:
            bound, kind, node = heapq.heappop(heap)
            if bound >= best - slack:
                closed_bound = min(closed_bound, bound)
                continue
            nodes += 1
            relaxed_bound, z = self._solve_relaxation(rows, price, node)
            bound = max(bound, relaxed_bound)
            if z is None or bound >= best - slack:
                if kind >= 0:
                    closed_bound = min(closed_bound, bound)
                continue
            violation = self._measure_violations(rows, z, node)
            nearest = violation.argmin(axis=1)
            min_violation = violation[np.arange(len(nearest)), nearest]
            violated = np.flatnonzero(min_violation > _VIOLATED)
            if not len(violated):
                if bound < best:
                    best, best_assignment = bound, nearest
                continue
            if kind < 0:
                continue
            worst = violated[np.argsort(-min_violation[violated], kind="stable")]
            split = select_split(self.form, rows.value, self._rates, node, self.choices[worst])
            for mask, gain in zip(split.children, split.gains, strict=True):
                child = (*node[: split.choice], mask, *node[split.choice + 1 :])
                heapq.heappush(heap, (bound + float(gain), num_created, child))
                num_created += 1
        open_bound = min((bound for bound, kind, _ in heap if kind >= 0), default=np.inf)
        return ComponentMinimum(min(best, closed_bound, open_bound), best_assignment, price, nodes)

    def _fix_choices(self, masks: Masks, assignment: IntArray) -> Masks:
        """Return sets of alternatives with the component's choices fixed at an assignment."""
        fixed = list(masks)
        for c, r in zip(self.choices, assignment, strict=True):
            fixed[c] = 1 << int(r)
        return tuple(fixed)

    def _select_rows(self) -> _ComponentRows:
        """Select the component's rows from the pool, except those of single alternatives."""
        form, base = self.form, self.form.choice_rows.start
        rows = np.flatnonzero(
            (self.pool.component == self.component) & ~self.pool.is_of_alternative
        )
        in_choice = form.list_rows_of(self.choices)
        return _ComponentRows(
            M=np.ascontiguousarray(self.pool.M[rows, self.columns]),
            lower=self.pool.lower[rows],
            upper=self.pool.upper[rows],
            chosen=np.searchsorted(rows, in_choice),
            in_choice=in_choice - base,
            value=np.zeros(form.choice_rows.stop - base),
            z=np.zeros(form.size),
        )

    def _solve_relaxation(
        self, rows: _ComponentRows, price: Array, node: Masks
    ) -> tuple[float, Array | None]:
        """Solve a node over the hulls of its alternatives.

        Returns:
            Bound of the node, infinite if multipliers prove that it is infeasible, and the
            minimiser, None without one.
        """
        sets = tuple(node[c] for c in self.choices)
        rows.lower[rows.chosen], rows.upper[rows.chosen] = self.form.compute_bounds_of(
            self.choices, sets
        )
        M, lower, upper = self._append_alternative_rows(rows.M, rows.lower, rows.upper, node)
        sense = np.where(upper - lower <= SAME, 5, 0).astype(np.int32)
        z, _, flag, info = daqp.solve(
            self._identity, price, M, upper, lower, sense, primal_tol=_TOLERANCE
        )
        if flag in _OPTIMAL:
            return _compute_dual_value(price, M, lower, upper, info["lam"]), z
        if flag != _INFEASIBLE:
            return -np.inf, None
        max_value = self._max_value(price)
        bound = compute_farkas_bound(price, M, lower, upper, np.zeros(self.size), max_value)
        return np.inf if bound >= max_value else bound, None

    def _measure_violations(self, rows: _ComponentRows, z: Array, node: Masks) -> Array:
        """Return the violation (choices, R) of alternatives at z; set the rows' values."""
        rows.value[rows.in_choice] = rows.M[rows.chosen] @ z
        rows.z[self.columns] = z
        allowed = self.form.decode_masks(node)
        violation = compute_violations(self.form, rows.z, rows.value, allowed, self.groups)
        return violation[self.choices]

    def _append_alternative_rows(
        self, M: Array, low: Array, high: Array, masks: Masks
    ) -> tuple[Array, Array, Array]:
        """Append the rows of alternatives that are the only ones of their choice."""
        form = self.form
        alternatives = [
            form.build_alternative_rows(int(c), masks[c].bit_length() - 1)
            for c in self.choices
            if not form.tables[c].is_complete and masks[c] & (masks[c] - 1) == 0
        ]
        if not alternatives:
            return M, low, high
        rows = [
            np.ascontiguousarray(alternative.rows[:, self.columns]) for alternative in alternatives
        ]
        return (
            np.concatenate([M, *rows]),
            np.concatenate([low, *(alternative.lower for alternative in alternatives)]),
            np.concatenate([high, *(alternative.upper for alternative in alternatives)]),
        )

    def _max_value(self, price: Array) -> float:
        """Return an upper bound over feasible points of the component: the cost bounds |z|."""
        form = self.form
        radius = np.sqrt(2.0 * max(form.max_cost - form.cost.constant, 0.0))
        return float(0.5 * radius**2 + np.linalg.norm(price) * radius)


def _compute_dual_value(
    price: Array, M: Array, lower: Array, upper: Array, multiplier: Array
) -> float:
    """Return the dual value of multipliers."""
    active = np.flatnonzero(multiplier)
    m = multiplier[active]
    gradient = price + m @ M[active]
    return float(-0.5 * gradient @ gradient - m @ np.where(m > 0, upper[active], lower[active]))


def build_component_problems(form: NormalForm, pool: RowPool) -> list[ComponentProblem]:
    """Build the components with choices that have no flat coordinates.

    Components that equations fix entirely are left out.
    """
    with_choices = set(form.choice_component) & set(form.cost.component)
    return [
        ComponentProblem(form, pool, int(p))
        for p in sorted(with_choices - set(form.cost.component[form.cost.flat]))
    ]
