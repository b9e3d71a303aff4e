"""A search over contacts whose nodes draw ranges closer: branch and bound with rebuilt envelopes.

Each node decides for one more leg and knot whether it stands, asks the head of the walk about that
knot where motions can be then, and states the whole program anew with what it says: envelopes,
tangents and slacks are those of the node and not of the root. The lowest bound comes first.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.walking.micp.heads import Stated, drawn_about
from climbplan.walking.micp.ranges import Box
from climbplan.walking.micp.relaxed import SAG, linear, relaxed
from climbplan.walking.micp.statement import Relaxation
from climbplan.walking.task import Array

_AHEAD = 2  # undecided knots among which the leg is chosen that stands by half
_UNSURE = 0.05  # of a contact, that it is worth to decide


@dataclass(frozen=True)
class Node:
    """Motions that are left, what they cost at least, and where the relaxed program has legs."""

    box: Box
    bound: float
    stands: Array  # (N, L) shares of contacts

    @property
    def choice(self) -> tuple[int, int] | None:
        """The knot and leg that are decided next; None if all are."""
        open_ = self.box.stands_low < self.box.stands_high
        knots = np.flatnonzero(open_.any(axis=1))
        if not len(knots):
            return None
        half = np.where(open_, np.minimum(self.stands, 1.0 - self.stands), -1.0)
        for rows in (knots[:_AHEAD], knots):
            row, leg = np.unravel_index(int(half[rows].argmax()), half[rows].shape)
            if half[rows[row], leg] > _UNSURE:
                return int(rows[row]), int(leg)
        return int(knots[0]), int(open_[knots[0]].argmax())


def searched(
    stated: Stated,
    root: Node,
    later: Sequence[float],
    goes_on: Callable[[float], bool],
    solved: Callable[[Relaxation, float], float],
) -> float:
    """What motions of a node cost at least, `stated.most` if there are none.

    later: (N + 1) what intervals from a knot on cost at least; goes_on: asked before each node, of
    the bound by then; solved: a bound of a node's program with its binaries, by its limit.
    """
    waiting, count = [(root.bound, 0, root)], 0
    whole = stated.most  # the lowest bound of what is decided and still possible
    while waiting and goes_on(min(waiting[0][0], whole)):
        _, _, node = heapq.heappop(waiting)
        choice = node.choice
        if choice is None:
            whole = min(whole, node.bound)
            continue
        for stands in (0.0, 1.0):
            child = decided(stated, node, choice, stands, later)
            if child is None:
                continue
            bound = max(child.bound, solved(stated.program(child.box), stated.most))
            if bound < stated.most:
                count += 1
                heapq.heappush(waiting, (bound, count, replace(child, bound=bound)))
    bound = min([whole, *(bound for bound, _, _ in waiting)])
    goes_on(bound)
    return bound


def decided(
    stated: Stated, node: Node, choice: tuple[int, int], stands: float, later: Sequence[float]
) -> Node | None:
    """The motions of a node where a leg stands at a knot, or does not; None if there are none."""
    low, high = node.box.stands_low.copy(), node.box.stands_high.copy()
    low[choice] = high[choice] = stands
    box = replace(node.box, stands_low=low, stands_high=high)
    first = node_of(stated, box)
    if first is None:
        return None
    drawn = drawn_about(stated, box, choice[0], later)
    found = node_of(stated, drawn) if drawn is not None else None
    return replace(found, bound=max(found.bound, first.bound, node.bound)) if found else None


def node_of(stated: Stated, box: Box) -> Node | None:
    """What motions of a box cost at least, by linear programs; None if there are none."""
    program, node = stated.program(box), None
    for bound, x in relaxed(program.model, SAG * stated.most, linear()):
        if x is None or bound >= stated.most:
            return None
        node = Node(box, max(bound, 0.0), program.standing(x))
    return node if node is not None else Node(box, 0.0, 0.5 * (box.stands_low + box.stands_high))
