"""One search of the compiled tree, in pieces, with the arrays that it works on.

Between pieces of some nodes Python looks at the clock and at signals. Where one node may take long
the search runs aside, and is stopped within the node.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.interruption import run_aside
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.memory import Leaves
from climbplan.solvers.mixed_integer.nodes import MOST, Search, Tree
from climbplan.solvers.mixed_integer.numbers import MixedIntegerProgram, with_room
from climbplan.solvers.mixed_integer.search import run as run_tree
from climbplan.solvers.mixed_integer.working_set import Rows, working

_FIRST_ROOM = 256  # nodes
_LONG = 300_000  # entries of rows from which a node may take a tenth of a second
_WORK = 2e8  # about how many entries of rows are looked at between two looks at the clock
_SOON = 1.0  # [s] to a deadline that is kept to a thousandth
_TANGENTS = 120  # rows of room for the tangents of each ball, to begin with
MEMORY = 600e6  # [bytes] of nodes
HINTS = 64  # sets of integers that may be proposed


@contextmanager
def _alarm(deadline: float, stop: NDArray[np.uint8]) -> Iterator[None]:
    """Set `stop` at the deadline."""
    if np.isinf(deadline):
        yield
        return
    timer = threading.Timer(max(deadline - time.perf_counter(), 0.0), stop.fill, (1,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@dataclass
class TreeRun:
    """One search, in pieces."""

    program: MixedIntegerProgram
    search: Search
    tree: Tree
    full: bool = False  # stopped because its nodes fill the memory

    @classmethod
    def of(
        cls,
        program: MixedIntegerProgram,
        gap: float,
        tolerance: float,
        leaves: Leaves | None = None,
        work: int = MOST,
    ) -> TreeRun:
        """A tree with its root, or with the leaves of an earlier one."""
        tangents = _TANGENTS * len(program.numbers.radius)
        program = replace(program, numbers=with_room(program.numbers, tangents))
        search = _search(program, tangents, gap, tolerance)
        search.whole[place.WORK] = work
        room = _FIRST_ROOM + (0 if leaves is None else 2 * len(leaves.low))
        tree = _tree(len(program.numbers.column), len(search.main.row), room)
        n = program.numbers
        if leaves is not None and leaves.into(program, search, tree):
            return cls(program, search, tree)
        tree.low[0], tree.high[0] = n.lowest, n.highest
        tree.bound[0] = -np.inf
        search.whole[place.COUNT] = search.whole[place.HEAP] = 1
        return cls(program, search, tree)

    def go(self, deadline: float, nodes: int = MOST) -> None:
        """Search until the gap is proved, nothing is left, or a limit.

        deadline: of `time.perf_counter` [s]. What is open at a limit stays open.
        """
        stop = self.search.rows.stop
        stop[0] = 0
        if self.program.M.size < _LONG:
            # A node may find tangents to balls for a long time
            if deadline - time.perf_counter() > _SOON and not len(self.program.numbers.radius):
                self._pieces(deadline, nodes)
                return
            with _alarm(deadline, stop):
                self._pieces(deadline, nodes)
            return
        with _alarm(deadline, stop):
            run_aside(lambda: self._pieces(deadline, nodes), lambda: stop.fill(1))

    def _pieces(self, deadline: float, nodes: int) -> None:
        m, k = self.program.M.shape
        piece = int(np.clip(_WORK / (max(m, 1) * max(k, 1) * 40), 1, 2000))
        while True:
            end = run_tree(self.program.numbers, self.search, self.tree, piece, nodes)
            if end == place.DONE:
                return
            if end == place.GROW:
                if 2 * _bytes(self.tree) > MEMORY:
                    self.full = True
                    return
                self.tree = _grown(self.tree)
            if end == place.GROW_ROWS:
                self._more_rows()
            if time.perf_counter() >= deadline:
                return

    def _more_rows(self) -> None:
        """Twice the room for rows."""
        s, m = self.search, len(self.search.rows.on)
        self.program = replace(self.program, numbers=with_room(self.program.numbers, m))
        rows = s.rows._replace(
            M=_longer(s.rows.M, 0, m),
            T=_longer(s.rows.T, 1, m),
            lower=_longer(s.rows.lower, 0, m),
            upper=_longer(s.rows.upper, 0, m),
            on=_longer(s.rows.on, 0, m),
            tolerance=_longer(s.rows.tolerance, 0, m),
        )
        main, probe = (
            w._replace(active=_longer(w.active, 0, m), value=_longer(w.value, 0, m))
            for w in (s.main, s.probe)
        )
        self.search = s._replace(
            rows=rows,
            main=main,
            probe=probe,
            base_lower=_longer(s.base_lower, 0, m),
            base_upper=_longer(s.base_upper, 0, m),
            offset=_longer(s.offset, 0, m),
            tangent_to=_longer(s.tangent_to, 0, m),
            direction=_longer(s.direction, 0, m),
        )

    def propose(self, integers: IntArray) -> None:
        """Sets (H, E) of integers to try at the first node, before any that it waits for."""
        n, whole = self.program.numbers, self.search.whole
        inside = ((integers >= n.lowest) & (integers <= n.highest)).all(axis=1)
        for row in integers[inside]:
            if whole[place.HINTED] < HINTS:
                self.search.hint[whole[place.HINTED]] = row
                whole[place.HINTED] += 1

    @property
    def bound(self) -> float:
        """A lower bound on the optimum."""
        real, whole = self.search.real, self.search.whole
        bound = float(real[place.LEFT_BOUND])
        waiting = self.tree.heap[: whole[place.HEAP]]
        bound = min(bound, float(self.tree.bound[waiting].min(initial=np.inf)))
        if whole[place.NEXT] >= 0:
            bound = min(bound, float(self.tree.bound[whole[place.NEXT]]))
        return min(bound, float(real[place.BEST]))

    @property
    def finished(self) -> bool:
        """Whether every node was closed by a proof."""
        whole = self.search.whole
        waiting = whole[place.HEAP] + (whole[place.NEXT] >= 0) + whole[place.UNPROVED]
        return bool(waiting == 0)

    @property
    def worked(self) -> bool:
        """Whether the dual steps that it may make are made."""
        steps = self.search.main.iterations[0] + self.search.probe.iterations[0]
        return bool(steps >= self.search.whole[place.WORK])

    @property
    def exhausted(self) -> bool:
        """Whether nothing is left open and everything was proved empty."""
        whole = self.search.whole
        open_nodes = whole[place.HEAP] + (whole[place.NEXT] >= 0)
        return bool(open_nodes == 0 and self.search.real[place.LEFT_BOUND] == np.inf)

    def best(self) -> Array | None:
        """The incumbent, in the variables of the conditional form."""
        if np.isinf(self.search.real[place.BEST]):
            return None
        return self.program.point(self.search.best_w, self.search.best_whole)


def _search(program: MixedIntegerProgram, tangents: int, gap: float, tolerance: float) -> Search:
    n = program.numbers
    stated, k = program.M.shape
    m = stated + tangents
    E = len(n.column)
    n.spatial.last[:] = np.nan
    real = np.zeros(8)
    real[place.BEST] = real[place.LEFT_BOUND] = np.inf
    real[place.GAP] = gap
    real[place.FEASIBILITY] = 0.3 * tolerance
    real[place.CONSTANT] = n.constant + 0.5 * float(n.eps @ n.center**2) - 0.5 * float(n.u @ n.u)
    whole = np.zeros(12, np.int64)
    whole[place.NEXT] = -1
    rows = Rows(
        M=_longer(program.M, 0, tangents),
        T=_longer(program.T, 1, tangents),
        lower=n.lower.copy(),
        upper=n.upper.copy(),
        on=np.ones(m, np.uint8),
        tolerance=_longer(program.tolerance, 0, tangents),
        used=np.array([stated]),
        stop=np.zeros(1, np.uint8),
    )
    return Search(
        real=real,
        whole=whole,
        rows=rows,
        main=working(m, k),
        probe=working(m, k),
        base_lower=n.lower.copy(),
        base_upper=n.upper.copy(),
        offset=n.offset.copy(),
        u=n.u.copy(),
        center=n.center.copy(),
        tangent_to=np.full(m, -1),
        direction=np.zeros((m, n.ball.shape[1])),
        w=np.zeros(k),
        best_w=np.zeros(k),
        best_whole=np.zeros(E, np.int64),
        gain=np.zeros((2, E)),
        seen=np.zeros((2, E), np.int64),
        distance=np.zeros((2, E)),
        low=np.zeros(E, np.int64),
        high=np.zeros(E, np.int64),
        hint=np.zeros((HINTS, E), np.int64),
        chosen=np.zeros(E, np.int64),
        seed=np.zeros(k),
        seed_whole=np.zeros(E, np.int64),
        spare=np.zeros((2, k)),
        shift=np.zeros(m),
        score=np.zeros(E),
        vector=np.zeros(n.ball.shape[1]),
    )


def _longer(part: Any, axis: int, by: int) -> Any:
    """An array with room behind it."""
    shape = list(part.shape)
    shape[axis] = by
    return np.ascontiguousarray(np.concatenate([part, np.zeros(shape, part.dtype)], axis=axis))


def _tree(integers: int, active: int, room: int) -> Tree:
    return Tree(
        low=np.zeros((room, integers), np.int32),
        high=np.zeros((room, integers), np.int32),
        bound=np.zeros(room),
        state=np.zeros(room, np.int8),
        depth=np.zeros(room, np.int32),
        row=np.zeros((room, active), np.int32),
        side=np.zeros((room, active), np.int8),
        multiplier=np.zeros((room, active)),
        active=np.zeros(room, np.int32),
        heap=np.zeros(room, np.int32),
    )


def _grown(tree: Tree) -> Tree:
    """The same tree with twice the room."""
    return Tree(*(np.concatenate([part, np.zeros_like(part)]) for part in tree))


def _bytes(tree: Tree) -> int:
    return sum(part.nbytes for part in tree)
