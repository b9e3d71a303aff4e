"""Workers on this machine: processes of joblib's loky, one pool of one process for each worker.

A pool of its own means that a worker that dies or hangs takes down its own chunk and no other.
"""

from __future__ import annotations

import os
import queue
import re
import time
from concurrent.futures import Future
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from joblib.externals.loky import ProcessPoolExecutor
from joblib.externals.loky.process_executor import BrokenProcessPool

from climbplan.datasets.engine import Done
from climbplan.datasets.recipe import Chunk, Recipe
from climbplan.datasets.work import ONE_THREAD, make_rows, start_worker

_START = 120.0  # [s] beyond the rows' own: imports, compilation


@dataclass
class _BusyProcess:
    """A worker at work."""

    pool: Any
    chunk: Chunk
    future: Future[Any]
    until: float  # [s] monotonic; a process that was stopped cannot end itself


class LocalEngine:
    """`jobs` worker processes with one solver thread each."""

    def __init__(self, recipe: Recipe, jobs: int) -> None:
        self._recipe = recipe
        self._jobs = jobs
        self._free: list[Any] = []
        self._busy: dict[int, _BusyProcess] = {}
        self._ended: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._tickets = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for pool in [*self._free, *(busy.pool for busy in self._busy.values())]:
            _stop_pool(pool)
        self._free, self._busy = [], {}

    @property
    def width(self) -> int:
        """The number of worker processes."""
        return self._jobs

    def idle(self) -> bool:
        """Return whether a worker has nothing to do."""
        return len(self._busy) < self._jobs

    def submit(self, chunk: Chunk) -> None:
        """Give a chunk to an idle worker, started if need be."""
        pool = self._free.pop() if self._free else _start_pool()
        try:
            future = pool.submit(make_rows, self._recipe, chunk)
        except BrokenProcessPool:  # it died while it had nothing to do
            _stop_pool(pool)
            pool = _start_pool()
            future = pool.submit(make_rows, self._recipe, chunk)
        self._tickets += 1
        ticket = self._tickets
        until = time.monotonic() + _START + self._recipe.row_seconds * len(chunk.rows)
        self._busy[ticket] = _BusyProcess(pool, chunk, future, until)
        future.add_done_callback(lambda _: self._ended.put(ticket))

    def wait(self, seconds: float) -> list[Done]:
        """Return chunks that ended; after `seconds` at the latest."""
        tickets = []
        try:
            tickets.append(self._ended.get(timeout=seconds))
            while True:
                tickets.append(self._ended.get_nowait())
        except queue.Empty:
            pass
        done = [self._finish(self._busy.pop(t)) for t in tickets if t in self._busy]
        now = time.monotonic()
        for ticket in [t for t, busy in self._busy.items() if now > busy.until]:
            busy = self._busy.pop(ticket)
            _stop_pool(busy.pool)
            done.append(Done(busy.chunk, lost="its worker hung"))
        return done

    def _finish(self, busy: _BusyProcess) -> Done:
        try:
            rows = busy.future.result()
        except BrokenProcessPool as error:
            _stop_pool(busy.pool)
            return Done(busy.chunk, lost=f"its worker died{_format_exit_code(error)}")
        self._free.append(busy.pool)
        return Done(busy.chunk, tuple(rows))


def _start_pool() -> Any:
    return ProcessPoolExecutor(
        max_workers=1, env=ONE_THREAD, initializer=start_worker, initargs=(os.getpid(),)
    )


def _stop_pool(pool: Any) -> None:
    pool.shutdown(wait=True, kill_workers=True)


def _format_exit_code(error: BrokenProcessPool) -> str:
    """Return how the process ended, as loky's message has it: " (SIGKILL(-9))"."""
    match = re.search(r"\{([A-Z]+\(-?\d+\))", str(error))
    return f" ({match[1]})" if match else ""
