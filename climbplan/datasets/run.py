"""A run: rows that are missing are made by an engine and kept in shards, until none is missing."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from climbplan.datasets.engine import Done, Engine
from climbplan.datasets.recipe import Chunk
from climbplan.datasets.shards import ShardStore
from climbplan.store.dataset import ANSWERED
from climbplan.store.dataset_row import Row, RowAnswer, derive_seed

_WAIT = 0.2  # [s]
_AT_ONCE = 1.0  # [s] of work that a worker is asked for at once
_MOST_ROWS = 64  # of a chunk
_ATTEMPTS = 2  # a row that loses its worker is tried once more


@dataclass(frozen=True)
class Count:
    """How far a run is."""

    total: int
    done: int
    answered: int
    seconds: float  # since the run was started or went on
    new: int  # rows of these seconds

    @property
    def rate(self) -> float:
        """Rows a second [1/s]."""
        return self.new / self.seconds if self.seconds > 0 else 0.0

    @property
    def left(self) -> float:
        """Time that is left [s]."""
        return (self.total - self.done) / self.rate if self.new else math.inf


def run_rows(
    store: ShardStore,
    engine: Engine,
    seed: int,
    present: Iterable[int] = (),
    answered: int = 0,
    report: Callable[[Count], None] | None = None,
) -> Count:
    """Make all rows of a store that are not `present`, on any engine.

    answered: how many of those present have an answer. Every row comes to an end: one whose worker
    died or hung is tried once more, alone, and is a failure then. Raises UsageError if the disk
    does not take the shards, and what making the source raises; what was made by then is kept.
    """
    had = frozenset(present)
    missing = [index for index in range(store.count) if index not in had]
    state = _RunProgress(store, seed, _Pending(missing), answered, len(had), report)
    try:
        while state.pending or state.working:
            while state.pending and engine.idle():
                engine.submit(state.pending.take(engine.width))
                state.working += 1
            for done in engine.wait(_WAIT):
                state.working -= 1
                state.take(done)
            state.tell()
    finally:
        store.flush()
    return state.count()


class _Pending:
    """Rows to be made: those to be tried again first, each alone."""

    def __init__(self, missing: list[int]) -> None:
        self._again: deque[Chunk] = deque()
        self._missing = deque(missing)
        self._pace = 0.0  # [s] a row

    def __bool__(self) -> bool:
        return bool(self._again or self._missing)

    def again(self, chunk: Chunk) -> None:
        self._again.append(chunk)

    def learn(self, seconds: float, rows: int) -> None:
        """Update the mean time of a row [s], by which the requests of workers are sized."""
        pace = seconds / max(rows, 1)
        self._pace = pace if self._pace == 0.0 else 0.8 * self._pace + 0.2 * pace

    def take(self, workers: int) -> Chunk:
        if self._again:
            return self._again.popleft()
        fair_size = -(-len(self._missing) // (2 * workers))  # towards the end all are busy
        target_size = 1 if self._pace == 0.0 else int(_AT_ONCE / max(self._pace, 1e-6))
        size = max(1, min(target_size, _MOST_ROWS, fair_size))
        return Chunk(tuple(self._missing.popleft() for _ in range(min(size, len(self._missing)))))


class _RunProgress:
    """What became of the rows so far."""

    def __init__(
        self,
        store: ShardStore,
        seed: int,
        pending: _Pending,
        answered: int,
        had: int,
        report: Callable[[Count], None] | None,
    ) -> None:
        self.pending = pending
        self.working = 0
        self._store, self._seed, self._report = store, seed, report
        self._had, self._answered, self._new = had, answered, 0
        self._begin = self._last = time.monotonic()
        self._reasons: dict[int, str] = {}

    def take(self, done: Done) -> None:
        """Keep rows; see to those of a worker that was lost."""
        if not done.lost:
            rows = [self._explain(row) for row in done.rows]
            self._store.add(rows)
            self._new += len(rows)
            self._answered += sum(row.answer.status in ANSWERED for row in rows)
            self.pending.learn(self._sum_time(rows), len(rows))
            return
        chunk = done.chunk
        for index in chunk.rows:
            if chunk.only_draw:  # not even the sampler survives
                row = Row(index, derive_seed(self._seed, index), None, RowAnswer("failed"))
                self._store.add([self._explain(row)])
                self._new += 1
                continue
            if chunk.attempt + 1 < _ATTEMPTS:
                self.pending.again(Chunk((index,), chunk.attempt + 1))
            else:
                self._reasons[index] = f"{done.lost}, twice"
                self.pending.again(Chunk((index,), chunk.attempt + 1, only_draw=True))

    def _explain(self, row: Row) -> Row:
        """Return a row that was given up says why."""
        reason = self._reasons.get(row.index)
        if reason is None or row.answer.status != "failed":
            return row
        return replace(row, answer=replace(row.answer, message=reason))

    def _sum_time(self, rows: list[Row]) -> float:
        """Return time of some rows, the sampler's included: what the whole run needed for a row."""
        solving = sum(row.answer.time for row in rows)
        return max(solving, 1e-4 * len(rows))

    def count(self) -> Count:
        """Return how far it is."""
        seconds = time.monotonic() - self._begin
        done = self._had + self._new
        return Count(self._store.count, done, self._answered, seconds, self._new)

    def tell(self) -> None:
        """Report how far it is."""
        if self._report is not None:
            self._report(self.count())
