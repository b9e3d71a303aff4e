"""Run the compiled tree in pieces, and grow the arrays on which it works.

Between pieces of some nodes Python checks the clock and signals. Where one node may take long, the
search runs in another thread, and is stopped within the node.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.progress import is_observed, report_search
from climbplan.solvers.interruption import run_in_thread
from climbplan.solvers.mixed_integer import nodes as slots
from climbplan.solvers.mixed_integer.leaf_cover import LeafCover
from climbplan.solvers.mixed_integer.nodes import UNLIMITED, NodeTree, SearchState
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram, extend_rows
from climbplan.solvers.mixed_integer.search import run_search as run_tree
from climbplan.solvers.mixed_integer.working_set import WorkingSetRows, allocate_working_set

_INITIAL_CAPACITY = 256  # initial capacity in nodes
_LARGE_PROGRAM = 300_000  # entries of rows from which a node may take a tenth of a second
_WORK_PER_PIECE = 2e8  # approximate number of entries processed between checks of the clock
_NEAR_DEADLINE = 1.0  # time to a deadline that is kept to a thousandth [s]
_TANGENTS_PER_BALL = 120  # initial number of spare rows for the tangents of each ball
MEMORY = 600e6  # memory limit of nodes [bytes]
MAX_PROPOSALS = 64  # largest number of proposed sets of integers


@contextmanager
def _stop_at(deadline: float, stop: NDArray[np.uint8]) -> Iterator[None]:
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
    """One search, which runs in pieces."""

    program: MixedIntegerProgram
    search: SearchState
    tree: NodeTree
    is_full: bool = False  # whether the nodes have reached the memory limit
    max_given_up: int = UNLIMITED  # leaves without a proof at which the search ends

    @classmethod
    def create(
        cls,
        program: MixedIntegerProgram,
        gap: float,
        tolerance: float,
        leaves: LeafCover | None = None,
        work: int = UNLIMITED,
    ) -> TreeRun:
        """Create a tree with its root, or with the leaves of an earlier one."""
        tangents = _TANGENTS_PER_BALL * len(program.data.radius)
        program = replace(program, data=extend_rows(program.data, tangents))
        search = _allocate_search(program, tangents, gap, tolerance)
        search.counters[slots.MAX_DUAL_STEPS] = work
        capacity = _INITIAL_CAPACITY + (0 if leaves is None else 2 * len(leaves.low))
        tree = _allocate_tree(len(program.data.value_row), len(search.main.row), capacity)
        data = program.data
        if leaves is not None and leaves.start_tree(program, search, tree):
            return cls(program, search, tree)
        tree.low[0], tree.high[0] = data.root_low, data.root_high
        tree.bound[0] = -np.inf
        search.counters[slots.NUM_NODES] = search.counters[slots.NUM_OPEN] = 1
        return cls(program, search, tree)

    def run_until(self, deadline: float, nodes: int = UNLIMITED) -> None:
        """Search until the gap is proved, no node is open, or a limit is reached.

        Args:
            deadline: Time of `time.perf_counter` [s]; open nodes stay open.
            nodes: Largest number of nodes.
        """
        stop = self.search.rows.stop
        stop[0] = 0
        if self.program.M.size < _LARGE_PROGRAM:
            # A node with balls may add tangents for a long time
            if deadline - time.perf_counter() > _NEAR_DEADLINE and not len(
                self.program.data.radius
            ):
                self._run_pieces(deadline, nodes)
                return
            with _stop_at(deadline, stop):
                self._run_pieces(deadline, nodes)
            return
        with _stop_at(deadline, stop):
            context = copy_context()  # of the meter that observes the search
            run_in_thread(
                lambda: context.run(self._run_pieces, deadline, nodes), lambda: stop.fill(1)
            )

    def _run_pieces(self, deadline: float, nodes: int) -> None:
        """Run pieces of nodes and check the deadline between them."""
        m, k = self.program.M.shape
        piece = int(np.clip(_WORK_PER_PIECE / (max(m, 1) * max(k, 1) * 40), 1, 2000))
        while True:
            reason = run_tree(self.program.data, self.search, self.tree, piece, nodes)
            if is_observed():
                report_search(float(self.search.scalars[slots.INCUMBENT_COST]), self.bound)
            if reason == slots.DONE:
                return
            if reason == slots.GROW:
                if 2 * _count_bytes(self.tree) > MEMORY:
                    self.is_full = True
                    return
                self.tree = _double_capacity(self.tree)
            if reason == slots.GROW_ROWS:
                self._double_rows()
            if time.perf_counter() >= deadline or self.num_given_up >= self.max_given_up:
                return

    def _double_rows(self) -> None:
        """Double the capacity for rows."""
        s, m = self.search, len(self.search.rows.enabled)
        self.program = replace(self.program, data=extend_rows(self.program.data, m))
        rows = s.rows._replace(
            M=_extend(s.rows.M, 0, m),
            T=_extend(s.rows.T, 1, m),
            lower=_extend(s.rows.lower, 0, m),
            upper=_extend(s.rows.upper, 0, m),
            enabled=_extend(s.rows.enabled, 0, m),
            tolerance=_extend(s.rows.tolerance, 0, m),
        )
        main, probe = (
            w._replace(
                active=_extend(w.active, 0, m),
                value=_extend(w.value, 0, m),
                pool=_extend(w.pool, 0, m),
            )
            for w in (s.main, s.probe)
        )
        self.search = s._replace(
            rows=rows,
            main=main,
            probe=probe,
            base_lower=_extend(s.base_lower, 0, m),
            base_upper=_extend(s.base_upper, 0, m),
            offset=_extend(s.offset, 0, m),
            tangent_to=_extend(s.tangent_to, 0, m),
            direction=_extend(s.direction, 0, m),
            shift=_extend(s.shift, 0, m),
        )

    def propose(self, integers: IntArray) -> None:
        """Propose sets (H, E) of integers to try at the first node."""
        data, counters = self.program.data, self.search.counters
        inside = ((integers >= data.root_low) & (integers <= data.root_high)).all(axis=1)
        for row in integers[inside]:
            if counters[slots.NUM_PROPOSALS] < MAX_PROPOSALS:
                self.search.proposals[counters[slots.NUM_PROPOSALS]] = row
                counters[slots.NUM_PROPOSALS] += 1

    @property
    def bound(self) -> float:
        """Lower bound on the optimum."""
        scalars, counters = self.search.scalars, self.search.counters
        bound = float(scalars[slots.CLOSED_BOUND])
        open_nodes = self.tree.heap[: counters[slots.NUM_OPEN]]
        bound = min(bound, float(self.tree.bound[open_nodes].min(initial=np.inf)))
        if counters[slots.DIVE_NODE] >= 0:
            bound = min(bound, float(self.tree.bound[counters[slots.DIVE_NODE]]))
        return min(bound, float(scalars[slots.INCUMBENT_COST]))

    @property
    def num_given_up(self) -> int:
        """Return the number of leaves that were neither solved nor proved infeasible."""
        return int(self.search.counters[slots.NUM_UNPROVED])

    @property
    def is_finished(self) -> bool:
        """Return whether every node was closed by a proof."""
        counters = self.search.counters
        num_unfinished = (
            counters[slots.NUM_OPEN]
            + (counters[slots.DIVE_NODE] >= 0)
            + counters[slots.NUM_UNPROVED]
        )
        return bool(num_unfinished == 0)

    @property
    def has_used_budget(self) -> bool:
        """Return whether the limit of dual steps is reached."""
        steps = self.search.main.iterations[0] + self.search.probe.iterations[0]
        return bool(steps >= self.search.counters[slots.MAX_DUAL_STEPS])

    @property
    def proves_infeasible(self) -> bool:
        """Return whether no node is open and every leaf was proved infeasible."""
        counters = self.search.counters
        open_nodes = counters[slots.NUM_OPEN] + (counters[slots.DIVE_NODE] >= 0)
        return bool(open_nodes == 0 and self.search.scalars[slots.CLOSED_BOUND] == np.inf)

    def recover_incumbent(self) -> Array | None:
        """Return the incumbent in the variables of the indicator form."""
        if np.isinf(self.search.scalars[slots.INCUMBENT_COST]):
            return None
        return self.program.recover_point(self.search.best_w, self.search.best_integers)


def _allocate_search(
    program: MixedIntegerProgram, tangents: int, gap: float, tolerance: float
) -> SearchState:
    """Allocate the state of a search."""
    data = program.data
    num_stated, k = program.M.shape
    m = num_stated + tangents
    E = len(data.value_row)
    data.spatial.last_box[:] = np.nan
    scalars = np.zeros(8)
    scalars[slots.INCUMBENT_COST] = scalars[slots.CLOSED_BOUND] = np.inf
    scalars[slots.GAP] = gap
    scalars[slots.ZERO_COST] = program.zero_cost
    scalars[slots.FEASIBILITY] = 0.3 * tolerance
    scalars[slots.CONSTANT] = (
        data.constant + 0.5 * float(data.eps @ data.center**2) - 0.5 * float(data.u @ data.u)
    )
    counters = np.zeros(12, np.int64)
    counters[slots.DIVE_NODE] = -1
    rows = WorkingSetRows(
        M=_extend(program.M, 0, tangents),
        T=_extend(program.T, 1, tangents),
        lower=data.lower.copy(),
        upper=data.upper.copy(),
        enabled=np.ones(m, np.uint8),
        tolerance=_extend(program.tolerance, 0, tangents),
        num_used=np.array([num_stated]),
        stop=np.zeros(1, np.uint8),
    )
    return SearchState(
        scalars=scalars,
        counters=counters,
        rows=rows,
        main=allocate_working_set(m, k),
        probe=allocate_working_set(m, k),
        base_lower=data.lower.copy(),
        base_upper=data.upper.copy(),
        offset=data.offset.copy(),
        u=data.u.copy(),
        center=data.center.copy(),
        tangent_to=np.full(m, -1),
        direction=np.zeros((m, data.ball.shape[1])),
        w=np.zeros(k),
        best_w=np.zeros(k),
        best_integers=np.zeros(E, np.int64),
        gain_sum=np.zeros((2, E)),
        num_gains=np.zeros((2, E), np.int64),
        distance=np.zeros((2, E)),
        low=np.zeros(E, np.int64),
        high=np.zeros(E, np.int64),
        proposals=np.zeros((MAX_PROPOSALS, E), np.int64),
        trial_integers=np.zeros(E, np.int64),
        start_w=np.zeros(k),
        start_integers=np.zeros(E, np.int64),
        scratch=np.zeros((2, k)),
        shift=np.zeros(m),
        score=np.zeros(E),
        vector=np.zeros(data.ball.shape[1]),
    )


def _extend(array: Any, axis: int, length: int) -> Any:
    """Return an array extended by zeros."""
    shape = list(array.shape)
    shape[axis] = length
    return np.ascontiguousarray(np.concatenate([array, np.zeros(shape, array.dtype)], axis=axis))


def _allocate_tree(num_integers: int, max_active: int, capacity: int) -> NodeTree:
    """Allocate nodes."""
    return NodeTree(
        low=np.zeros((capacity, num_integers), np.int32),
        high=np.zeros((capacity, num_integers), np.int32),
        bound=np.zeros(capacity),
        state=np.zeros(capacity, np.int8),
        depth=np.zeros(capacity, np.int32),
        row=np.zeros((capacity, max_active), np.int32),
        side=np.zeros((capacity, max_active), np.int8),
        multiplier=np.zeros((capacity, max_active)),
        active=np.zeros(capacity, np.int32),
        heap=np.zeros(capacity, np.int32),
    )


def _double_capacity(tree: NodeTree) -> NodeTree:
    """Return the same tree with twice the capacity."""
    return NodeTree(*(np.concatenate([array, np.zeros_like(array)]) for array in tree))


def _count_bytes(tree: NodeTree) -> int:
    """Return the memory of a tree [bytes]."""
    return sum(array.nbytes for array in tree)
