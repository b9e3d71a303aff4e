"""Branch and bound over integers with second-order cone programs as nodes.

Each node is solved by Clarabel without the variables that integers and rows fix, and its bound is
the dual value. Integers need no bounds, and neither do directions without cost: the relaxation of
the root shows whether the program is bounded. Branching follows pseudo-costs (Achterberg, Koch and
Martin, "Branching rules revisited", 2005); nodes are taken in depth until one is pruned, then by
their bounds.
"""

from __future__ import annotations

import heapq
import time
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Literal

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange, RowPropagation
from climbplan.progress import report_search
from climbplan.solvers.mixed_integer.certification import SplitTree
from climbplan.solvers.mixed_integer.conic_relaxation import ConicRelaxation, NodeSolution
from climbplan.solvers.result import (
    FEASIBILITY,
    compute_closing_bound,
    compute_zero_cost,
    relative_gap,
)

_INTEGRAL = 1e-6  # distance from an integer within which a variable is one
_ROUNDS = 3  # of propagation at a node
_ABSOLUTE = 5e-8  # gap that is enough whatever the cost: dual values are no more accurate
_PRUNE = 0.5  # fraction of the gap at which nodes are pruned
_HEURISTIC = 10  # nodes between roundings of a relaxation's integers
_DIVE = 50  # nodes without an incumbent before the first dive for one, doubled after each
_DIVE_STEPS = 20  # largest number of steps of a dive, for each integer
_SMALLEST_GAIN = 1e-6
_MAX_INTEGER = 1e9  # integers beyond are not branched on

RootStatus = Literal["bounded", "infeasible", "unbounded", "unsolved"]


@dataclass(order=True)
class _ConicNode:
    """An open node: its solved relaxation over a box of the integers."""

    bound: float
    number: int
    lower: Array = field(compare=False)  # (n,)
    upper: Array = field(compare=False)
    x: Array = field(compare=False)  # (n,) solution of the relaxation
    place: int = field(compare=False, default=0)  # of the node in `ConicTree.splits`


@dataclass
class _PseudoCosts:
    """Mean gains of the bound for each unit of rounding, by variable and direction."""

    gain: Array  # (2, n) sums
    number: Array  # (2, n)

    def update(self, direction: int, j: int, gain: float, distance: float) -> None:
        """Store the gain of one child."""
        self.gain[direction, j] += gain / max(distance, _INTEGRAL)
        self.number[direction, j] += 1.0

    def select(self, candidates: IntArray, fraction: Array) -> int:
        """Return the candidate with the largest product of expected gains."""
        is_counted = self.number > 0
        means = np.where(is_counted, self.gain / np.maximum(self.number, 1.0), np.nan)
        average = float(np.nanmean(means)) if is_counted.any() else 1.0
        means = np.where(is_counted, means, max(average, _SMALLEST_GAIN))[:, candidates]
        down, up = means[0] * fraction, means[1] * (1.0 - fraction)
        score = np.maximum(down, _SMALLEST_GAIN) * np.maximum(up, _SMALLEST_GAIN)
        return int(candidates[np.argmax(score)])


class ConicTree:
    """The search of one instance.

    Args:
        instance: Instance of rows, balls, cones, integers and a convex cost.
        gap: Relative gap to prove.
        tolerance: Largest violation of an incumbent.
        start: (n,) point whose integers are tried first.
    """

    def __init__(
        self,
        instance: Instance,
        gap: float = 1e-4,
        tolerance: float = FEASIBILITY,
        start: Array | None = None,
    ) -> None:
        self.instance, self.gap, self.tolerance, self.start = instance, gap, tolerance, start
        self.relaxation = ConicRelaxation(instance)
        self.zero_cost = compute_zero_cost(instance)
        self.incumbent: Array | None = None
        self.cost = np.inf
        self.num_nodes = 0
        self.root: RootStatus = "unsolved"
        self.root_solution: Array | None = None
        self.is_finished = False
        self._integers = np.flatnonzero(instance.integer)
        self._rows = RowPropagation(instance.A.copy(), instance.row_lower, instance.row_upper)
        self._open: list[_ConicNode] = []
        self._numbers = count()
        self._pruned_bound = np.inf  # least bound of nodes that were pruned by the gap
        self.splits = SplitTree()
        self._tried: set[bytes] = set()
        self._next_dive = _DIVE
        shape = (2, instance.size)
        self._costs = _PseudoCosts(np.zeros(shape), np.zeros(shape))

    @property
    def bound(self) -> float:
        """Valid lower bound on the optimum; infinite where no point is feasible."""
        if self.root == "infeasible":
            return np.inf
        if self.root != "bounded":
            return -np.inf
        smallest = min((node.bound for node in self._open), default=np.inf)
        return min(smallest, self._pruned_bound, self.cost)

    def run(self, deadline: float, max_nodes: int) -> None:
        """Search until the gap is proved, the deadline or the largest number of nodes.

        Args:
            deadline: Time of `time.perf_counter` [s].
            max_nodes: Largest number of relaxations.
        """
        node = self._solve_root() if self.num_nodes == 0 else None
        if self.root != "bounded":
            return
        while node is not None or self._open:
            if time.perf_counter() >= deadline or self.num_nodes >= max_nodes:
                if node is not None:
                    heapq.heappush(self._open, node)
                return
            if node is None:
                node = heapq.heappop(self._open)
            if self.incumbent is None and self.num_nodes >= self._next_dive:
                self._dive(node, deadline)
                self._next_dive = 2 * self.num_nodes
            node = self._branch(node)
            bound = self.bound_with(node)
            report_search(self.cost, bound)
            gap = relative_gap(self.cost, bound, self.zero_cost)
            if gap <= self.gap or self.cost - bound <= _ABSOLUTE:
                if node is not None:
                    heapq.heappush(self._open, node)
                break
        self.is_finished = True

    def _dive(self, node: _ConicNode, deadline: float) -> None:
        """Look for an incumbent: raise the integer that is nearest to the one above, and go on.

        Binaries of which one has to be 1 are so decided one group at a time. Where a child is empty
        the integer is kept below instead, once in a row. Among integers without bounds there may be
        no end of that.
        """
        lower, upper, x = node.lower.copy(), node.upper.copy(), node.x
        for _ in range(_DIVE_STEPS * len(self._integers)):
            if self.incumbent is not None or time.perf_counter() >= deadline:
                return
            integers = self._integers[lower[self._integers] < upper[self._integers]]
            fraction = x[integers] - np.floor(x[integers])
            fraction[(fraction < _INTEGRAL) | (fraction > 1.0 - _INTEGRAL)] = 0.0
            if not fraction.any():
                self._complete(x, lower, upper)
                return
            j = int(integers[np.argmax(fraction)])
            above, below = lower.copy(), upper.copy()
            above[j], below[j] = np.floor(x[j]) + 1.0, np.floor(x[j])
            child = self._solve_box(above, upper) or self._solve_box(lower, below)
            if child is None:
                return
            lower, upper, x = child

    def _solve_box(self, lower: Array, upper: Array) -> tuple[Array, Array, Array] | None:
        """Return the tightened box of a child and its relaxation's solution; None if empty."""
        box = self._propagate(lower.copy(), upper.copy())
        if box is None:
            return None
        solution = self._solve(*box)
        return (*box, solution.x) if solution.status == "solved" else None

    def bound_with(self, node: _ConicNode | None) -> float:
        """Return the bound with a node that is not in the heap."""
        smallest = self._open[0].bound if self._open else np.inf
        return min(smallest, self._pruned_bound, self.cost, np.inf if node is None else node.bound)

    def _solve_root(self) -> _ConicNode | None:
        """Solve the relaxation of all points; None where the search is over."""
        lower, upper = self.instance.lower.copy(), self.instance.upper.copy()
        box = self._propagate(lower, upper)
        if box is None:
            self.root, self.is_finished = "infeasible", True
            return None
        solution = self._solve(*box)
        if solution.status != "solved":
            self.root = solution.status
            self.is_finished = solution.status == "infeasible"
            return None
        self.root, self.root_solution = "bounded", solution.x
        if self.start is not None:
            self._complete(self.start, *box)
        return self._accept(solution, *box)

    def offer(self, point: Array | None) -> None:
        """Take a feasible point as the incumbent where it is better."""
        if point is not None and (cost := self.instance.objective(point)) < self.cost:
            self.incumbent, self.cost = point, cost

    def _solve(self, lower: Array, upper: Array) -> NodeSolution:
        """Solve the relaxation of a box."""
        self.num_nodes += 1
        return self.relaxation.solve(lower, upper)

    def _propagate(self, lower: Array, upper: Array) -> tuple[Array, Array] | None:
        """Tighten a box by rows; None where it is empty."""
        bounds, integers = ElementwiseRange(lower, upper), self._integers
        for _ in range(_ROUNDS):
            tightened = self._rows.tighten(bounds)
            low, high = tightened.lower, tightened.upper
            low[integers] = np.ceil(low[integers] - _INTEGRAL)
            high[integers] = np.floor(high[integers] + _INTEGRAL)
            if (low > high + self.tolerance).any():
                return None
            is_last = not bounds.has_progressed(tightened)
            bounds = tightened
            if is_last:
                break
        return bounds.lower, bounds.upper

    def _accept(self, solution: NodeSolution, lower: Array, upper: Array) -> _ConicNode | None:
        """Return an open node of a solved relaxation; None where it is pruned."""
        if solution.bound >= self._cutoff:
            self._pruned_bound = min(self._pruned_bound, solution.bound)
            return None
        integers, x = self._integers, solution.x
        rounded = np.round(x[integers])
        is_integral = np.abs(x[integers] - rounded).max(initial=0.0) <= _INTEGRAL
        if is_integral:
            point = x.copy()
            point[integers] = rounded
            if self.instance.violation(point) <= self.tolerance:
                self.offer(point)
        if is_integral or self.num_nodes % _HEURISTIC == 1:
            self._complete(x, lower, upper)
            if solution.bound >= self._cutoff:
                self._pruned_bound = min(self._pruned_bound, solution.bound)
                return None
        return _ConicNode(solution.bound, next(self._numbers), lower, upper, x)

    @property
    def _cutoff(self) -> float:
        """Bound from which on a node is pruned."""
        if self.incumbent is None:
            return np.inf
        closed = compute_closing_bound(self.cost, _PRUNE * self.gap, self.zero_cost)
        return min(closed, self.cost - _ABSOLUTE)

    def _branch(self, node: _ConicNode) -> _ConicNode | None:
        """Solve both children; return the one to dive into, the other one is pushed."""
        if node.bound >= self._cutoff:
            self._pruned_bound = min(self._pruned_bound, node.bound)
            return None
        j, value = self._select(node)
        if j < 0:
            self._pruned_bound = min(self._pruned_bound, node.bound)  # numerically stuck
            return None
        children: list[_ConicNode] = []
        places = self.splits.append(node.place, j, float(np.floor(value)))
        for direction in (0, 1):
            lower, upper = node.lower.copy(), node.upper.copy()
            distance = value - np.floor(value)
            if direction == 0:
                upper[j] = np.floor(value)
            else:
                lower[j], distance = np.floor(value) + 1.0, 1.0 - distance
            child = self._solve_child(node, lower, upper)
            if child is None:
                continue
            child.place = places[direction]
            self._costs.update(direction, j, max(child.bound - node.bound, 0.0), distance)
            children.append(child)
        children.sort()
        for child in children[1:]:
            heapq.heappush(self._open, child)
        return children[0] if children else None

    def _solve_child(self, node: _ConicNode, lower: Array, upper: Array) -> _ConicNode | None:
        """Solve a child; None where it is empty or pruned."""
        box = self._propagate(lower, upper)
        if box is None:
            return None
        solution = self._solve(*box)
        if solution.status == "infeasible":
            return None
        if solution.status != "solved":
            solution = NodeSolution("solved", np.clip(node.x, *box), node.bound)
        solution = replace(solution, bound=max(solution.bound, node.bound))
        return self._accept(solution, *box)

    def _select(self, node: _ConicNode) -> tuple[int, float]:
        """Return the variable to branch on and the value to branch at; -1 for none.

        Where all integers are integral, an open one is divided at its value.
        """
        integers, x = self._integers, node.x
        is_open = node.lower[integers] < node.upper[integers]
        distance = np.abs(x[integers] - np.round(x[integers]))
        candidates = integers[
            is_open & (distance > _INTEGRAL) & (np.abs(x[integers]) < _MAX_INTEGER)
        ]
        if len(candidates):
            j = self._costs.select(candidates, x[candidates] - np.floor(x[candidates]))
            return j, float(x[j])
        remaining = integers[is_open]
        if not len(remaining):
            return -1, 0.0
        j = int(remaining[0])
        value = float(np.round(x[j]))
        return j, value - 0.5 if value >= node.upper[j] else value + 0.5

    def _complete(self, x: Array, lower: Array, upper: Array) -> None:
        """Try the best point with the rounded integers of x as an incumbent."""
        values = np.clip(np.round(x[self._integers]), lower[self._integers], upper[self._integers])
        if values.tobytes() in self._tried:
            return
        self._tried.add(values.tobytes())
        low, high = self.instance.lower.copy(), self.instance.upper.copy()
        low[self._integers] = high[self._integers] = values
        box = self._propagate(low, high)
        if box is None:
            return
        point = self.relaxation.solve_exactly(*box, self.tolerance)
        if point is None:
            return
        cost = self.instance.objective(point)
        if cost < self.cost and self.instance.violation(point) <= self.tolerance:
            self.incumbent, self.cost = point, cost
