"""The tree of `branch_and_bound`: nodes, their order, and what is done at each."""

from __future__ import annotations

import heapq
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.result import LEAST_OBJECTIVE, Known, relative_gap
from climbplan.solvers.tree.block_minima import BlockMinimum, blocks
from climbplan.solvers.tree.branching import best_split, single_gains, violations
from climbplan.solvers.tree.dual_gains import RowRates, row_rates
from climbplan.solvers.tree.incumbent import IncumbentStore
from climbplan.solvers.tree.normal_form import Masks, NormalForm
from climbplan.solvers.tree.relaxation import Closed, Point, Relaxation

# Rounds of ball cuts, and the violation from which balls are cut [m]
_ROOT_CUTS, _NODE_CUTS, _LEAF_ROUNDS = (30, 1e-6), (4, 1e-5), 100
_SMALL_PROGRESS = 1e-5  # relative rise of the bound below which a node's cut rounds stop
_BLOCK_NODES_ROOT, _BLOCK_NODES = 2000, 200
MEMORY = 600e6  # [bytes] of open nodes and rows at which a search ends with what it has
_NODE_BYTES = 600  # of a node itself, and its share of what it has in common with others
_BLOCK_SLACK = 0.1  # share of the gap that all parts together may leave unproved


@dataclass(frozen=True)
class Node:
    """A set of allowed alternatives for every choice, and what its parent knew."""

    bound: float
    masks: Masks  # what differs from the parent is one set; the others are shared with it
    start: Point
    minima: tuple[BlockMinimum | None, ...]


class TreeSearch:
    """One run of branch and bound."""

    def __init__(
        self,
        instance: Instance,
        form: NormalForm,
        gap: float,
        deadline: float,
        tolerance: float,
        known: Known | None = None,
        most: float = np.inf,
        proposals: Sequence[IntArray] = (),
    ) -> None:
        self.instance, self.form, self.gap, self.most = instance, form, gap, most
        self.deadline, self.tolerance = deadline, tolerance
        self.known = known or Known()
        self.proposals = [] if self.known.assignment is None else [self.known.assignment]
        self.proposals += proposals
        self.relaxation = Relaxation(form, self._late)
        self.blocks = blocks(form, self.relaxation.pool)
        self.incumbents = IncumbentStore(instance, self.relaxation, gap, tolerance)
        self.nodes = 0
        self.log: list[str] = []
        self.closed = np.inf  # least bound of nodes that were left without being infeasible
        self._open: list[tuple[float, int, Node]] = []
        self._dive: list[Node] = []
        self._made = 0
        self._begin = time.perf_counter()

    # ---- the loop

    def run(self) -> None:
        """Search until the gap is proved, nothing is left, `most` nodes, or the deadline."""
        root = self.root()
        self._open.append((root.bound, 0, root))
        for proposal in self.proposals:
            if self._possible(proposal):
                self.incumbents.complete(proposal, root.start, self._late)
                self._note("earlier choices")
        while (self._open or self._dive) and not self._late():
            if self._bytes() > MEMORY:
                self._note(f"open nodes and rows fill {1e-6 * MEMORY:.0f} MB")
                break
            if self.nodes >= self.most:
                self._note(f"{self.nodes} nodes, as many as it may take")
                break
            node = self._dive.pop() if self._dive else heapq.heappop(self._open)[2]
            if node.bound >= self.incumbents.cutoff:
                self.closed = min(self.closed, node.bound)
                continue
            self.nodes += 1
            self._process(node)
            if self.nodes & (self.nodes - 1) == 0:
                self._note("")
        self._note("done")

    def root(self) -> Node:
        """The node that allows everything."""
        return Node(self.known.bound, self.form.root, self.relaxation.start(), ())

    def _possible(self, assignment: IntArray) -> bool:
        allowed = self.form.allowed
        if len(assignment) != len(allowed) or (assignment >= allowed.shape[1]).any():
            return False
        return bool(allowed[np.arange(len(assignment)), assignment].all())

    def _bytes(self) -> int:
        """About what open nodes and the pool take."""
        open_nodes = len(self._open) + len(self._dive)
        each = _NODE_BYTES + 8 * len(self.form.tables) + 4 * self.form.size
        return open_nodes * each + self.relaxation.pool.bytes

    def _late(self) -> bool:
        return time.perf_counter() >= self.deadline

    @property
    def bound(self) -> float:
        """A lower bound on the optimum."""
        best = min([self.closed, *(b for b, _, _ in self._open), *(n.bound for n in self._dive)])
        return float(min(best, self.incumbents.objective))

    @property
    def exhausted(self) -> bool:
        """Whether every part of the tree was shown to hold no feasible point."""
        if self._open or self._dive:
            return False
        # -inf is a node that was left without any bound, which proves nothing
        return self.closed == np.inf or self.closed > self.form.ceiling

    # ---- one node

    def _process(self, node: Node) -> None:
        """Relax, bound, try for an incumbent, exclude alternatives, branch."""
        is_root = self.nodes == 1
        while True:
            rounds, excess = _ROOT_CUTS if is_root else _NODE_CUTS
            point = self._cut_rounds(node, rounds, excess, stop_early=True)
            if point is None:
                return
            node = replace(node, bound=max(node.bound, point.bound), start=point)
            value = self._choice_values(point)
            allowed = self.form.flags(node.masks)
            off = violations(self.form, point.z, value, allowed)
            nearest = off.argmin(axis=1)
            if not (off.min(axis=1) > 0.5 * self.tolerance).any():
                self._leaf(node)
                return
            bounds = self.relaxation.bounds(node.masks)
            minima, gains = self._block_gains(node, point, *bounds, is_root)
            node = replace(
                node, bound=max(node.bound, point.bound + gains.sum()), minima=tuple(minima)
            )
            if self.incumbents.complete(self._guess(nearest, minima), point, self._late):
                self._note("incumbent")
            if node.bound >= self.incumbents.cutoff:
                self.closed = min(self.closed, node.bound)
                return
            rates = self._rates(point, *bounds)
            kept = self._excluded(node, allowed, point, value, rates, gains)
            if not kept.any(axis=1).all():
                return
            if (kept != allowed).any():
                node = replace(node, masks=self.form.masks(kept))
            off = np.where(kept, off, np.inf)
            narrow = kept.sum(axis=1) == 1
            decided = (off.min(axis=1)[narrow] > 0.5 * self.tolerance).any()
            if decided and point.solved and not self._late():
                continue  # an exclusion decided a choice: relax again before branching
            break
        self._branch(node, point, value, rates, off, gains)

    def _cut_rounds(
        self, node: Node, rounds: int, tolerated: float, stop_early: bool
    ) -> Point | None:
        """The node's relaxation with ball cuts; None if the node is closed by it."""
        point, last = node.start, -np.inf
        for k in range(rounds):
            lower, upper = self.relaxation.bounds(node.masks)
            solved = self.relaxation.solve(lower, upper, point, self.incumbents.cutoff)
            if isinstance(solved, Closed):
                if not solved.certified:
                    self._note("DAQP says infeasible, its multipliers do not prove it")
                self.closed = min(self.closed, solved.bound if solved.certified else node.bound)
                return None
            point = solved
            if not point.solved:
                self._note("DAQP failed; the bound is that of some rows")
                break
            if self._late():
                break
            made = self.relaxation.cut_balls(point.z, tolerated)
            if made.count == 0:
                break
            small = point.bound - last < _SMALL_PROGRESS * abs(point.bound)
            if stop_early and k and small and made.excess < 1e-3:
                break
            last = point.bound
        return point

    def _choice_values(self, point: Point) -> Array:
        return np.asarray(self.form.rows[self.form.choice_rows] @ point.z)

    def _leaf(self, node: Node) -> None:
        """No choice is violated: converge the balls, then the point is feasible."""
        point = self._cut_rounds(node, _LEAF_ROUNDS, 0.4 * self.tolerance, stop_early=False)
        if point is None:
            return
        node = replace(node, bound=max(node.bound, point.bound), start=point)
        allowed = self.form.flags(node.masks)
        off = violations(self.form, point.z, self._choice_values(point), allowed)
        nearest = off.argmin(axis=1)
        if point.solved and (off.min(axis=1) > 0.5 * self.tolerance).any():
            self._push([node])
            return
        if self.incumbents.accept(point.z, nearest):
            self._note("incumbent")
        self.closed = min(self.closed, node.bound)

    def _guess(self, nearest: IntArray, minima: list[BlockMinimum | None]) -> IntArray:
        """The parts' minimisers, and the nearest alternatives where there are none."""
        guess = nearest.copy()
        for block, minimum in zip(self.blocks, minima, strict=True):
            if minimum is not None and minimum.assignment is not None:
                guess[block.choices] = minimum.assignment
        return guess

    # ---- bounds beyond the relaxation

    def _block_gains(
        self, node: Node, point: Point, lower: Array, upper: Array, is_root: bool
    ) -> tuple[list[BlockMinimum | None], Array]:
        """Minima of all parts and what each adds to the relaxation's bound."""
        known = node.minima or (None,) * len(self.blocks)
        minima: list[BlockMinimum | None] = []
        gains = np.zeros(len(self.blocks))
        if len(self.blocks) < 2:
            return [None] * len(self.blocks), gains
        scale = max(abs(point.bound), LEAST_OBJECTIVE)
        slack = _BLOCK_SLACK * self.gap * scale / len(self.blocks)
        limit = _BLOCK_NODES_ROOT if is_root else _BLOCK_NODES
        for i, (block, before) in enumerate(zip(self.blocks, known, strict=True)):
            price = block.price(point)
            if before is None or not block.still_holds(before, price, node.masks):
                hint = None if before is None else before.assignment
                before = block.minimum(price, node.masks, slack, limit, self.deadline, hint)
            minima.append(before)
            gains[i] = max(0.0, before.bound - block.relaxed(point, lower, upper))
        return minima, gains

    def _rates(self, point: Point, lower: Array, upper: Array) -> RowRates:
        active = point.active
        return row_rates(
            self.form.rows[self.form.choice_rows],
            self.relaxation.pool.M[active],
            point.multiplier,
            upper[active] - lower[active] <= 0.0,
            point.z,
            self.form.cost,
        )

    def _excluded(
        self,
        node: Node,
        allowed: BoolArray,
        point: Point,
        value: Array,
        rates: RowRates,
        gains: Array,
    ) -> BoolArray:
        """Allowed alternatives less those whose sure gain reaches the cutoff: they are closed."""
        cutoff = self.incumbents.cutoff
        if np.isinf(cutoff):
            return allowed
        open_choices = allowed.sum(axis=1) > 1
        sure = single_gains(self.form, value, rates, open_choices)
        others = np.full(len(sure), gains.sum())
        for block, gain in zip(self.blocks, gains, strict=True):
            others[block.choices] -= gain
        reached = np.maximum(node.bound, point.bound + others[:, None] + sure)
        # The subtrees of excluded alternatives are closed with these bounds.
        closed = allowed & open_choices[:, None] & (reached >= cutoff)
        self.closed = min(self.closed, float(reached[closed].min(initial=np.inf)))
        return allowed & ~closed

    # ---- branching

    def _branch(
        self, node: Node, point: Point, value: Array, rates: RowRates, off: Array, gains: Array
    ) -> None:
        several = np.isfinite(off).sum(axis=1) > 1
        least = off.min(axis=1)
        violated = np.flatnonzero(several & (least > 0.5 * self.tolerance))
        if not len(violated):  # only where a relaxation was not solved
            self.closed = min(self.closed, node.bound)
            return
        worst_first = violated[np.argsort(-least[violated], kind="stable")]
        split = best_split(self.form, value, rates, node.masks, worst_first)
        others = gains.sum() - sum(
            gain
            for block, gain in zip(self.blocks, gains, strict=True)
            if split.choice in block.choices
        )
        children = []
        for mask, gain in zip(split.children, split.gains, strict=True):
            bound = max(node.bound, point.bound + others + float(gain))
            if bound >= self.incumbents.cutoff:
                self.closed = min(self.closed, bound)
                continue
            masks = (*node.masks[: split.choice], mask, *node.masks[split.choice + 1 :])
            children.append(replace(node, bound=bound, masks=masks))
        self._push(children)

    def _push(self, children: list[Node]) -> None:
        """Dive into the best child while there is no incumbent; best bound first otherwise."""
        children.sort(key=lambda child: child.bound)
        if self.incumbents.best is None and children:
            self._dive.append(children.pop(0))
        elif self._dive:
            children += self._dive
            self._dive = []
        for child in children:
            self._made += 1
            heapq.heappush(self._open, (child.bound, self._made, child))

    def _note(self, event: str) -> None:
        objective = self.incumbents.objective
        bound = self.bound
        gap = relative_gap(objective, bound) if np.isfinite(objective) else np.inf
        self.log.append(
            f"{time.perf_counter() - self._begin:8.2f} s  {self.nodes:6d} nodes "
            f"{len(self._open) + len(self._dive):6d} open  objective {objective:.8g}  "
            f"bound {bound:.8g}  gap {100 * gap:.3g} %  {event}".rstrip()
        )
