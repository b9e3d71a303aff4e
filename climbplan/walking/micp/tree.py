"""A search over contacts: branch and bound by linear programs that start where the last one ended.

What has the lowest bound comes first, and is followed into the depth for some linear programs, so
that most of them differ by one decision from the one before. Which leg is decided next is asked in
the order of knots: what a walk does first says most about the rest, and gaits that differ late
only are cut off together. Where all contacts are decided, ranges are drawn closer for that gait.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

from climbplan.walking.micp.kept import Decision, Kept
from climbplan.walking.task import Array, Flags

_PART = 40  # linear programs in the depth, before the lowest bound is next again


@dataclass
class Search:
    """What is open of the motions of a program, and what is known of them."""

    kept: Kept
    goes_on: Callable[[float], bool]  # asked before each program, of the bound by then
    left: Callable[[], float]  # [s] by the wall's clock
    settled: Callable[[Flags], float]  # what motions with these contacts cost at least
    told: Callable[[Array], None]  # of points with all contacts decided
    nodes: int = 0

    def run(self) -> float:
        """What motions cost at least, `most` if none costs less."""
        waiting: list[tuple[float, int, tuple[Decision, ...]]] = [(0.0, 0, ())]
        count, whole = 0, self.kept.most  # the lowest bound of what cannot be decided further
        while waiting and self.goes_on(min(waiting[0][0], whole)) and waiting[0][0] < whole:
            bound, _, decided = heapq.heappop(waiting)
            self.kept.begin()
            stack = [(bound, decided)]
            for _ in range(_PART):
                if not stack or not self.goes_on(min(bound, whole)):
                    break
                known, made = stack.pop()
                found = self.node(known, made)
                if found is None:
                    continue
                least, ways = found
                if ways is None:
                    whole = min(whole, least)
                    continue
                stack += [(least, (*made, way)) for way in reversed(ways)]
            for known, made in stack:
                count += 1
                heapq.heappush(waiting, (known, count, made))
        bound = min([whole, *(known for known, _, _ in waiting)])
        self.goes_on(bound)
        return bound

    def node(
        self, known: float, made: tuple[Decision, ...]
    ) -> tuple[float, tuple[Decision, Decision] | None] | None:
        """Its bound, and what is decided next, if anything; None if nothing in it is cheaper."""
        kept = self.kept
        kept.decide(made)
        found = kept.solve(self.left())
        self.nodes += 1
        if found is None:
            return None
        least, ways = max(known, found.bound), kept.next(found.x)
        contacts = kept.contacts
        if contacts is not None and (not made or made[-1].contact):  # once for each gait
            if found.x is not None:
                self.told(found.x)
            least = max(least, self.settled(contacts))
            if least >= kept.most:
                return None
        return least, ways
