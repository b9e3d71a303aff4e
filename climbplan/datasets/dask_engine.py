"""Workers of a Dask cluster: one that runs already, or one of this machine for the run.

Each chunk is sent to a worker by name, and a worker has one chunk at a time. What a lost worker was
at is known then, whatever the scheduler's own rules for lost workers are.
"""

from __future__ import annotations

import logging
import os
import queue
import re
import threading
import time
from dataclasses import dataclass
from types import ModuleType, TracebackType
from typing import Any, Self

from climbplan.datasets.engine import Done
from climbplan.datasets.recipe import Chunk, Recipe
from climbplan.datasets.work import ONE_THREAD, make_rows
from climbplan.errors import MissingSolver, UsageError
from climbplan.store.dataset_row import Row

_START = 120.0  # [s] beyond the rows' own: imports, compilation
_LOOK = 1.0  # [s] between looks at which workers there are
_CONNECT = 20.0  # [s]
_GRACE = 2.0  # [s] for the rows of a worker that has lost its scheduler
_CLOSING = ("closing", "closed", "failed")  # status of a worker without a scheduler
_LOCAL = re.compile(r"local-cluster:(\d+)")


@dataclass
class _BusyDaskWorker:
    """A worker at work."""

    address: str
    chunk: Chunk
    future: Any
    until: float  # [s] monotonic


class DaskEngine:
    """The workers of a scheduler, as they come and go."""

    def __init__(self, recipe: Recipe, scheduler: str) -> None:
        """scheduler: `tcp://...`, or `local-cluster:N` for N processes of this machine.

        Raises MissingSolver without Dask, UsageError for another kind of name.
        """
        self._distributed = _load_distributed()
        self._recipe = recipe
        self._scheduler = scheduler
        local = _LOCAL.fullmatch(scheduler)
        if local is None and "://" not in scheduler:
            raise UsageError(
                f"--scheduler {scheduler}: expected tcp://HOST:PORT or local-cluster:N"
            )
        self._local = int(local[1]) if local is not None else None
        if self._local == 0:
            raise UsageError(f"--scheduler {scheduler}: at least one worker expected")
        self._cluster: Any = None
        self._client: Any = None
        self._addresses: frozenset[str] = frozenset()
        self._abandoned: set[str] = set()
        self._looked_at = -_LOOK
        self._busy: dict[int, _BusyDaskWorker] = {}
        self._ended: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._tickets = 0

    def __enter__(self) -> Self:
        # Its loggers tell of every lost worker at length; ours say what was lost.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        if self._local is not None:
            self._cluster = self._distributed.LocalCluster(
                n_workers=self._local,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                env=ONE_THREAD,
                silence_logs=logging.CRITICAL,
            )
        address = self._cluster if self._cluster is not None else self._scheduler
        try:
            self._client = self._distributed.Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:  # OSError: nobody answers
            self._close()
            raise UsageError(f"--scheduler {self._scheduler}: cannot connect: {error}") from error
        self._refresh_workers()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        futures = [busy.future for busy in self._busy.values()]
        if futures and self._client.status == "running":
            self._client.cancel(futures, force=True)
        self._close()

    @property
    def width(self) -> int:
        """Workers that are there at the moment."""
        return max(1, len(self._addresses))

    def idle(self) -> bool:
        """Return whether a worker has nothing to do."""
        self._refresh_workers()
        return bool(self._idle())

    def submit(self, chunk: Chunk) -> None:
        """Give a chunk to an idle worker."""
        address = self._idle()[0]
        future = self._client.submit(
            make_rows_on_dask,
            self._recipe,
            chunk,
            pure=False,
            workers=[address],
            allow_other_workers=False,
        )
        self._tickets += 1
        ticket = self._tickets
        until = time.monotonic() + _START + self._recipe.row_seconds * len(chunk.rows)
        self._busy[ticket] = _BusyDaskWorker(address, chunk, future, until)
        future.add_done_callback(lambda _: self._ended.put(ticket))

    def wait(self, seconds: float) -> list[Done]:
        """Return chunks that ended; after `seconds` at the latest.

        Raises UsageError if the scheduler is gone.
        """
        tickets = []
        try:
            tickets.append(self._ended.get(timeout=seconds))
            while True:
                tickets.append(self._ended.get_nowait())
        except queue.Empty:
            pass
        done = [self._finish(self._busy.pop(t)) for t in tickets if t in self._busy]
        self._refresh_workers()
        now = time.monotonic()
        for ticket, busy in list(self._busy.items()):
            is_lost, is_late = busy.address not in self._addresses, now > busy.until
            if is_lost or is_late:
                del self._busy[ticket]
                self._client.cancel([busy.future], force=True)
                self._abandoned.add(busy.address)
                done.append(Done(busy.chunk, lost="its worker was lost" if is_lost else "it hung"))
        return done

    def _finish(self, busy: _BusyDaskWorker) -> Done:
        if busy.future.status in ("cancelled", "lost"):
            return Done(busy.chunk, lost="its worker was lost")
        try:
            return Done(busy.chunk, tuple(busy.future.result()))
        except self._distributed.KilledWorker:
            return Done(busy.chunk, lost="its worker was lost")
        except ImportError as error:
            raise UsageError(
                f"worker {busy.address} lacks something that this process has: {error}"
            ) from error

    def _idle(self) -> list[str]:
        busy_addresses = {busy.address for busy in self._busy.values()}
        return sorted(self._addresses - busy_addresses)

    def _refresh_workers(self) -> None:
        """See now and then which workers there are; one with several threads is refused."""
        now = time.monotonic()
        if now - self._looked_at < _LOOK:
            return
        self._looked_at = now
        if self._client.status != "running":
            raise UsageError(f"--scheduler {self._scheduler}: the scheduler is gone")
        try:
            threads = self._client.nthreads()
        except (OSError, TimeoutError) as error:
            raise UsageError(
                f"--scheduler {self._scheduler}: the scheduler is gone: {error}"
            ) from error
        several = [address for address, count in threads.items() if count != 1]
        if several:
            raise UsageError(
                f"--scheduler {self._scheduler}: worker {several[0]} has {threads[several[0]]} "
                "threads; start one process a core, each with one (--nthreads 1)"
            )
        self._addresses = frozenset(threads) - self._abandoned

    def _close(self) -> None:
        if self._client is not None:
            self._client.close(timeout=5)
        if self._cluster is not None:
            self._cluster.close(timeout=10)


def make_rows_on_dask(recipe: Recipe, chunk: Chunk) -> list[Row]:
    """Return the rows of a chunk, as `make_rows`; end the worker's process with its scheduler.

    A worker of Dask that has lost its scheduler waits for its task first, however long that takes.
    """
    worker = _load_distributed().get_worker()
    is_done = threading.Event()
    watch = threading.Thread(target=_end_without_scheduler, args=(worker, is_done), daemon=True)
    watch.start()
    try:
        return make_rows(recipe, chunk)
    finally:
        is_done.set()


def _end_without_scheduler(worker: Any, is_done: threading.Event) -> None:
    """End this process once its worker is closing and its rows are not done `_GRACE` later."""
    while worker.status.name not in _CLOSING:
        if is_done.wait(_LOOK):
            return
    if not is_done.wait(_GRACE):
        os._exit(1)


def _load_distributed() -> ModuleType:
    try:
        import distributed
    except ImportError as error:
        raise MissingSolver(
            "--scheduler needs Dask, which is not installed: pip install 'climbplan[cluster]'"
        ) from error
    return distributed
