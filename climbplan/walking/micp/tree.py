"""A search over contacts: branch and bound by linear programs that start where the last one ended.

What has the lowest bound comes first, and is followed into the depth for some linear programs, so
that most of them differ by one decision from the one before. Which leg is decided next is asked in
the order of knots: what a walk does first says most about the rest, and gaits that differ late
only are cut off together. Where all contacts are decided, ranges are drawn closer for that gait, as
soon as nothing else has a lower bound.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field

from climbplan.arrays import Array, BoolArray
from climbplan.walking.micp.kept import Decision, Kept

_PART = 40  # linear programs in the depth, before the lowest bound is next again


@dataclass
class Search:
    """What is open of the motions of a program, and what is known of them."""

    kept: Kept
    goes_on: Callable[[float], bool]  # asked before each program, of the bound by then
    left: Callable[[], float]  # [s] by the wall's clock
    settled: Callable[[BoolArray], float]  # what motions with these contacts cost at least
    told: Callable[[Array], None]  # of points with all contacts decided
    nodes: int = 0
    drawn: set[bytes] = field(default_factory=set)  # gaits that were settled

    def run(self) -> float:
        """What motions cost at least, `most` if none costs less."""
        waiting: list[tuple[float, int, tuple[Decision, ...], BoolArray | None]] = [
            (0.0, 0, (), None)
        ]
        self.drawn.clear()
        count, whole = 0, self.kept.most  # the lowest bound of what cannot be decided further
        while waiting and self.goes_on(min(waiting[0][0], whole)) and waiting[0][0] < whole:
            bound, _, decided, gait = heapq.heappop(waiting)
            if gait is not None:
                bound = max(bound, self.settled(gait))
                if bound < self.kept.most:
                    heapq.heappush(waiting, (bound, -1, decided, None))
                continue
            self.kept.begin()
            stack = [(bound, decided)]
            for _ in range(_PART):
                if not stack or not self.goes_on(min(bound, whole)):
                    break
                known, made = stack.pop()
                found = self.node(known, made)
                if found is None:
                    continue
                count += 1
                least, ways, gait = found
                if gait is not None:  # once its bound is the lowest
                    heapq.heappush(waiting, (least, count, made, gait))
                elif ways is None:
                    whole = min(whole, least)
                else:
                    stack += [(least, (*made, way)) for way in reversed(ways)]
            for known, made in stack:
                count += 1
                heapq.heappush(waiting, (known, count, made, None))
        bound = min([whole, *(known for known, *_ in waiting)])
        self.goes_on(bound)
        return bound

    def node(
        self, known: float, made: tuple[Decision, ...]
    ) -> tuple[float, tuple[Decision, Decision] | None, BoolArray | None] | None:
        """Its bound, what is decided next, if anything, and its gait, if ranges are to be drawn.

        None if nothing in it is cheaper.
        """
        kept = self.kept
        kept.decide(made)
        found = kept.solve(self.left())
        self.nodes += 1
        if found is None:
            return None
        least, gait = max(known, found.bound), kept.contacts
        if gait is not None and gait.tobytes() not in self.drawn:
            self.drawn.add(gait.tobytes())
            if found.x is not None:
                self.told(found.x)
            return least, None, gait
        return least, kept.next(found.x), None
