"""The tree of `branch_and_bound`: nodes, their order, and the processing of a node."""

from __future__ import annotations

import heapq
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.progress import is_observed, report_search
from climbplan.solvers.result import MIN_OBJECTIVE_SCALE, KnownResult, relative_gap
from climbplan.solvers.tree.block_minima import ComponentMinimum, build_component_problems
from climbplan.solvers.tree.branching import (
    compute_alternative_gains,
    compute_violations,
    select_split,
)
from climbplan.solvers.tree.dual_gains import DualSteps, compute_dual_steps
from climbplan.solvers.tree.incumbent import IncumbentStore
from climbplan.solvers.tree.normal_form import Masks, NormalForm
from climbplan.solvers.tree.relaxation import ClosedRelaxation, RelaxationPoint, RelaxationSolver

# Rounds of ball cuts, and the violation from which balls are cut [m]
_ROOT_CUTS, _NODE_CUTS, _LEAF_ROUNDS = (30, 1e-6), (4, 1e-5), 100
_NODES_BETWEEN_REPORTS = 16  # of progress
_SMALL_PROGRESS = 1e-5  # relative rise of the bound below which a node's cut rounds stop
_BLOCK_NODES_ROOT, _BLOCK_NODES = 2000, 200
MEMORY = 600e6  # memory of open nodes and rows at which a search ends [bytes]
_NODE_BYTES = 600  # approximate memory of a node apart from its arrays
_BLOCK_SLACK = 0.1  # fraction of the gap that all components together may leave unproved


@dataclass(frozen=True)
class ChoiceNode:
    """A set of allowed alternatives for every choice, and the results of its parent."""

    bound: float
    masks: Masks  # one set differs from the parent; the others are shared with it
    start: RelaxationPoint
    minima: tuple[ComponentMinimum | None, ...]


class TreeSearch:
    """One run of branch and bound."""

    def __init__(
        self,
        instance: Instance,
        form: NormalForm,
        gap: float,
        deadline: float,
        tolerance: float,
        known_result: KnownResult | None = None,
        *,
        max_nodes: float = np.inf,
        proposals: Sequence[IntArray] = (),
    ) -> None:
        """Prepare the relaxation, the components and the incumbent store."""
        self.instance, self.form, self.gap, self.max_nodes = instance, form, gap, max_nodes
        self.deadline, self.tolerance = deadline, tolerance
        self.known_result = known_result or KnownResult()
        self.proposals = (
            [] if self.known_result.assignment is None else [self.known_result.assignment]
        )
        self.proposals += proposals
        self.relaxation = RelaxationSolver(form, self._is_late)
        self.components = build_component_problems(form, self.relaxation.pool)
        self.incumbents = IncumbentStore(instance, self.relaxation, gap, tolerance)
        self.num_nodes = 0
        self.log: list[str] = []
        self.closed_bound = np.inf  # least bound of closed nodes that are not infeasible
        self._open: list[tuple[float, int, ChoiceNode]] = []
        self._dive: list[ChoiceNode] = []
        self._num_created = 0
        self._begin = time.perf_counter()

    # ---- the loop

    def run(self) -> None:
        """Search until the gap is proved, nothing is open, or a limit is reached."""
        root = self.create_root()
        self._open.append((root.bound, 0, root))
        for proposal in self.proposals:
            if self._is_allowed(proposal):
                self.incumbents.solve_assignment(proposal, root.start, self._is_late)
                self._log_progress("earlier choices")
        while (self._open or self._dive) and not self._is_late():
            if self._estimate_memory() > MEMORY:
                self._log_progress(f"open nodes and rows fill {1e-6 * MEMORY:.0f} MB")
                break
            if self.num_nodes >= self.max_nodes:
                self._log_progress(f"{self.num_nodes} nodes, as many as it may take")
                break
            node = self._dive.pop() if self._dive else heapq.heappop(self._open)[2]
            if node.bound >= self.incumbents.cutoff:
                self.closed_bound = min(self.closed_bound, node.bound)
                continue
            self.num_nodes += 1
            self._process(node)
            if self.num_nodes % _NODES_BETWEEN_REPORTS == 0 and is_observed():
                report_search(self.incumbents.objective, self.bound)
            if self.num_nodes & (self.num_nodes - 1) == 0:
                self._log_progress("")
        self._log_progress("done")

    def create_root(self) -> ChoiceNode:
        """Create the node that allows every alternative."""
        return ChoiceNode(
            self.known_result.bound, self.form.root_masks, self.relaxation.start(), ()
        )

    def _is_allowed(self, assignment: IntArray) -> bool:
        """Return whether the root allows an assignment."""
        allowed = self.form.allowed
        if len(assignment) != len(allowed) or (assignment >= allowed.shape[1]).any():
            return False
        return bool(allowed[np.arange(len(assignment)), assignment].all())

    def _estimate_memory(self) -> int:
        """Estimate the memory of open nodes and the pool [bytes]."""
        open_nodes = len(self._open) + len(self._dive)
        each = _NODE_BYTES + 8 * len(self.form.tables) + 4 * self.form.size
        return open_nodes * each + self.relaxation.pool.num_bytes

    def _is_late(self) -> bool:
        """Return whether the deadline has passed."""
        return time.perf_counter() >= self.deadline

    @property
    def bound(self) -> float:
        """Lower bound on the optimum."""
        best = min(
            [self.closed_bound, *(b for b, _, _ in self._open), *(n.bound for n in self._dive)]
        )
        return float(min(best, self.incumbents.objective))

    @property
    def proves_infeasible(self) -> bool:
        """Return whether every leaf of the tree was shown to contain no feasible point."""
        if self._open or self._dive:
            return False
        # -inf marks a node that was closed without any bound, which proves nothing
        return self.closed_bound == np.inf or self.closed_bound > self.form.max_cost

    # ---- one node

    def _process(self, node: ChoiceNode) -> None:
        """Relax, bound, try for an incumbent, exclude alternatives, branch."""
        is_root = self.num_nodes == 1
        while True:
            rounds, excess = _ROOT_CUTS if is_root else _NODE_CUTS
            point = self._relax_with_cuts(node, rounds, excess, stop_early=True)
            if point is None:
                return
            node = replace(node, bound=max(node.bound, point.bound), start=point)
            value = self._compute_choice_values(point)
            allowed = self.form.decode_masks(node.masks)
            violation = compute_violations(self.form, point.z, value, allowed)
            nearest = violation.argmin(axis=1)
            if not (violation.min(axis=1) > 0.5 * self.tolerance).any():
                self._process_leaf(node)
                return
            bounds = self.relaxation.compute_bounds(node.masks)
            minima, gains = self._compute_component_gains(node, point, *bounds, is_root)
            node = replace(
                node, bound=max(node.bound, point.bound + gains.sum()), minima=tuple(minima)
            )
            if self.incumbents.solve_assignment(
                self._combine_minimisers(nearest, minima), point, self._is_late
            ):
                self._log_progress("incumbent")
            if node.bound >= self.incumbents.cutoff:
                self.closed_bound = min(self.closed_bound, node.bound)
                return
            rates = self._compute_rates(point, *bounds)
            remaining = self._exclude_alternatives(node, allowed, point, value, rates, gains)
            if not remaining.any(axis=1).all():
                return
            if (remaining != allowed).any():
                node = replace(node, masks=self.form.encode_masks(remaining))
            violation = np.where(remaining, violation, np.inf)
            is_single = remaining.sum(axis=1) == 1
            decided = (violation.min(axis=1)[is_single] > 0.5 * self.tolerance).any()
            if decided and point.solved and not self._is_late():
                continue  # an exclusion decided a choice: relax again before branching
            break
        self._branch(node, point, value, rates, violation, gains)

    def _relax_with_cuts(
        self, node: ChoiceNode, max_rounds: int, tolerance: float, stop_early: bool
    ) -> RelaxationPoint | None:
        """Solve the node's relaxation with ball cuts; return None if that closes the node."""
        point, previous_bound = node.start, -np.inf
        for k in range(max_rounds):
            lower, upper = self.relaxation.compute_bounds(node.masks)
            relaxed = self.relaxation.solve(lower, upper, point, self.incumbents.cutoff)
            if isinstance(relaxed, ClosedRelaxation):
                if not relaxed.certified:
                    self._log_progress("DAQP says infeasible, its multipliers do not prove it")
                self.closed_bound = min(
                    self.closed_bound, relaxed.bound if relaxed.certified else node.bound
                )
                return None
            point = relaxed
            if not point.solved:
                self._log_progress("DAQP failed; the bound is that of some rows")
                break
            if self._is_late():
                break
            cuts = self.relaxation.cut_balls(point.z, tolerance)
            if cuts.count == 0:
                break
            is_small = point.bound - previous_bound < _SMALL_PROGRESS * abs(point.bound)
            if stop_early and k and is_small and cuts.excess < 1e-3:
                break
            previous_bound = point.bound
        return point

    def _compute_choice_values(self, point: RelaxationPoint) -> Array:
        """Return the values of choice rows."""
        return np.asarray(self.form.rows[self.form.choice_rows] @ point.z)

    def _process_leaf(self, node: ChoiceNode) -> None:
        """Converge the balls of a node without violated choices, and accept its point."""
        point = self._relax_with_cuts(node, _LEAF_ROUNDS, 0.4 * self.tolerance, stop_early=False)
        if point is None:
            return
        node = replace(node, bound=max(node.bound, point.bound), start=point)
        allowed = self.form.decode_masks(node.masks)
        violation = compute_violations(
            self.form, point.z, self._compute_choice_values(point), allowed
        )
        nearest = violation.argmin(axis=1)
        if point.solved and (violation.min(axis=1) > 0.5 * self.tolerance).any():
            self._push([node])
            return
        if self.incumbents.accept(point.z, nearest):
            self._log_progress("incumbent")
        self.closed_bound = min(self.closed_bound, node.bound)

    def _combine_minimisers(
        self, nearest: IntArray, minima: list[ComponentMinimum | None]
    ) -> IntArray:
        """Combine the components' minimisers with the nearest alternatives of other choices."""
        guess = nearest.copy()
        for block, minimum in zip(self.components, minima, strict=True):
            if minimum is not None and minimum.assignment is not None:
                guess[block.choices] = minimum.assignment
        return guess

    # ---- bounds beyond the relaxation

    def _compute_component_gains(
        self, node: ChoiceNode, point: RelaxationPoint, lower: Array, upper: Array, is_root: bool
    ) -> tuple[list[ComponentMinimum | None], Array]:
        """Return the minima of all components, and what each adds to the relaxation's bound."""
        parent_minima = node.minima or (None,) * len(self.components)
        minima: list[ComponentMinimum | None] = []
        gains = np.zeros(len(self.components))
        if len(self.components) < 2:
            return [None] * len(self.components), gains
        scale = max(abs(point.bound), MIN_OBJECTIVE_SCALE)
        slack = _BLOCK_SLACK * self.gap * scale / len(self.components)
        limit = _BLOCK_NODES_ROOT if is_root else _BLOCK_NODES
        for i, (block, minimum) in enumerate(zip(self.components, parent_minima, strict=True)):
            price = block.compute_price(point)
            if minimum is None or not block.is_reusable(minimum, price, node.masks):
                hint = None if minimum is None else minimum.assignment
                minimum = block.minimise(price, node.masks, slack, limit, self.deadline, hint)
            minima.append(minimum)
            gains[i] = max(0.0, minimum.bound - block.compute_relaxed_value(point, lower, upper))
        return minima, gains

    def _compute_rates(self, point: RelaxationPoint, lower: Array, upper: Array) -> DualSteps:
        """Return the dual steps of choice rows at a relaxation's solution."""
        active = point.active
        return compute_dual_steps(
            self.form.rows[self.form.choice_rows],
            self.relaxation.pool.M[active],
            point.multiplier,
            upper[active] - lower[active] <= 0.0,
            point.z,
            self.form.cost,
        )

    def _exclude_alternatives(
        self,
        node: ChoiceNode,
        allowed: BoolArray,
        point: RelaxationPoint,
        value: Array,
        rates: DualSteps,
        gains: Array,
    ) -> BoolArray:
        """Return the alternatives whose gain stays below the cutoff; the others are closed."""
        cutoff = self.incumbents.cutoff
        if np.isinf(cutoff):
            return allowed
        open_choices = allowed.sum(axis=1) > 1
        guaranteed = compute_alternative_gains(self.form, value, rates, open_choices)
        other_gains = np.full(len(guaranteed), gains.sum())
        for block, gain in zip(self.components, gains, strict=True):
            other_gains[block.choices] -= gain
        bounds = np.maximum(node.bound, point.bound + other_gains[:, None] + guaranteed)
        # The subtrees of excluded alternatives are closed with these bounds.
        closed = allowed & open_choices[:, None] & (bounds >= cutoff)
        self.closed_bound = min(self.closed_bound, float(bounds[closed].min(initial=np.inf)))
        return allowed & ~closed

    # ---- branching

    def _branch(
        self,
        node: ChoiceNode,
        point: RelaxationPoint,
        value: Array,
        rates: DualSteps,
        violation: Array,
        gains: Array,
    ) -> None:
        """Split a node at the most promising choice."""
        is_open = np.isfinite(violation).sum(axis=1) > 1
        min_violation = violation.min(axis=1)
        violated = np.flatnonzero(is_open & (min_violation > 0.5 * self.tolerance))
        if not len(violated):  # only where a relaxation was not solved
            self.closed_bound = min(self.closed_bound, node.bound)
            return
        worst_first = violated[np.argsort(-min_violation[violated], kind="stable")]
        split = select_split(self.form, value, rates, node.masks, worst_first)
        other_gains = gains.sum() - sum(
            gain
            for block, gain in zip(self.components, gains, strict=True)
            if split.choice in block.choices
        )
        children = []
        for mask, gain in zip(split.children, split.gains, strict=True):
            bound = max(node.bound, point.bound + other_gains + float(gain))
            if bound >= self.incumbents.cutoff:
                self.closed_bound = min(self.closed_bound, bound)
                continue
            masks = (*node.masks[: split.choice], mask, *node.masks[split.choice + 1 :])
            children.append(replace(node, bound=bound, masks=masks))
        self._push(children)

    def _push(self, children: list[ChoiceNode]) -> None:
        """Dive into the best child while there is no incumbent; best bound first otherwise."""
        children.sort(key=lambda child: child.bound)
        if self.incumbents.best is None and children:
            self._dive.append(children.pop(0))
        elif self._dive:
            children += self._dive
            self._dive = []
        for child in children:
            self._num_created += 1
            heapq.heappush(self._open, (child.bound, self._num_created, child))

    def _log_progress(self, event: str) -> None:
        """Append a line to the log."""
        objective, bound = self.incumbents.objective, self.bound
        report_search(objective, bound)
        gap = relative_gap(objective, bound) if np.isfinite(objective) else np.inf
        self.log.append(
            f"{time.perf_counter() - self._begin:8.2f} s  {self.num_nodes:6d} nodes "
            f"{len(self._open) + len(self._dive):6d} open  objective {objective:.8g}  "
            f"bound {bound:.8g}  gap {100 * gap:.3g} %  {event}".rstrip()
        )
