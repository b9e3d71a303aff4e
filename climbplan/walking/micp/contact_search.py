"""Branch and bound over the contacts of a walk, by linear programs with warm starts.

Node selection is best bound first with dives of limited length: within a dive most linear programs
differ by one decision from the one before. Branching follows the order of knots, as early contacts
decide most of the rest, so that gaits which differ late are pruned together. Where all contacts are
decided, bound tightening raises the bound of that gait once no other node has a lower one.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field

from climbplan.arrays import Array, BoolArray
from climbplan.walking.micp.node_lp import BranchingDecision, NodeLp

_DIVE_NODES = 40  # in a dive, before the node with the lowest bound is next


@dataclass
class ContactSearch:
    """A search tree over the contacts of a relaxation."""

    lp: NodeLp
    should_continue: Callable[[float], bool]  # called before each node with the current bound
    seconds_left: Callable[[], float]  # [s] of wall-clock time
    bound_gait: Callable[[BoolArray], float]  # lower bound on motions with contacts (N, L)
    report_solution: Callable[[Array], None]  # called with solutions of which all contacts are 0, 1
    num_nodes: int = 0
    bounded_gaits: set[bytes] = field(
        default_factory=set
    )  # those that await `bound_gait`, or had it

    def run(self) -> float:
        """Search until the tree is exhausted, or `should_continue` returns False.

        Returns:
            The lower bound on the cost of all motions; the cutoff if none is below it.
        """
        queue: list[tuple[float, int, tuple[BranchingDecision, ...], BoolArray | None]] = [
            (0.0, 0, (), None)
        ]
        self.bounded_gaits.clear()
        count, leaf_bound = 0, self.lp.cutoff  # the lowest bound of nodes that cannot branch
        while (
            queue
            and self.should_continue(min(queue[0][0], leaf_bound))
            and queue[0][0] < leaf_bound
        ):
            bound, _, decisions, gait = heapq.heappop(queue)
            if gait is not None:
                bound = max(bound, self.bound_gait(gait))
                if bound < self.lp.cutoff:
                    heapq.heappush(queue, (bound, -1, decisions, None))
                continue
            self.lp.reset()
            stack = [(bound, decisions)]
            for _ in range(_DIVE_NODES):
                if not stack or not self.should_continue(min(bound, leaf_bound)):
                    break
                parent_bound, decisions = stack.pop()
                node = self.solve_node(parent_bound, decisions)
                if node is None:
                    continue
                count += 1
                node_bound, branches, gait = node
                if gait is not None:  # bounded once its bound is the lowest
                    heapq.heappush(queue, (node_bound, count, decisions, gait))
                elif branches is None:
                    leaf_bound = min(leaf_bound, node_bound)
                else:
                    stack += [(node_bound, (*decisions, branch)) for branch in reversed(branches)]
            for parent_bound, decisions in stack:
                count += 1
                heapq.heappush(queue, (parent_bound, count, decisions, None))
        bound = min([leaf_bound, *(open_bound for open_bound, *_ in queue)])
        self.should_continue(bound)
        return bound

    def solve_node(
        self, parent_bound: float, decisions: tuple[BranchingDecision, ...]
    ) -> tuple[float, tuple[BranchingDecision, BranchingDecision] | None, BoolArray | None] | None:
        """Solve the linear program of a node.

        Args:
            parent_bound: Lower bound of the parent.
            decisions: The decisions that lead to the node.

        Returns:
            Its bound, the decisions of both children and its gait (N, L), each None if there is
            none; None if the node is pruned.
        """
        lp = self.lp
        lp.apply_decisions(decisions)
        solution = lp.solve(self.seconds_left())
        self.num_nodes += 1
        if solution is None:
            return None
        bound, gait = max(parent_bound, solution.bound), lp.decided_contacts
        if gait is not None and gait.tobytes() not in self.bounded_gaits:
            self.bounded_gaits.add(gait.tobytes())
            if solution.x is not None:
                self.report_solution(solution.x)
            return bound, None, gait
        return bound, lp.select_branching(solution.x), None
