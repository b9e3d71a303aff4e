"""What runs in the workers: rows made one by one, under a watch that ends a worker that hangs."""

from __future__ import annotations

import faulthandler
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.datasets.recipe import Chunk, Recipe
from climbplan.store.dataset_row import Row, RowAnswer, RowSource, derive_seed

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
_LOOK = 1.0  # [s] between looks for the process that started this one
_MOST_WORDS = 300  # of a message
_prepared: dict[str, RowSource[Any]] = {}  # the worker's own, by token: one at a time


def start_worker(parent: int) -> None:
    """Make a process a worker: deaf to Ctrl-C, which is its parent's, and gone when that is."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def make_rows(recipe: Recipe, chunk: Chunk) -> list[Row]:
    """Return the rows of a chunk, in order. Raises what making the source raises; rows never do."""
    source = _prepared.get(recipe.token)
    if source is None:
        source = recipe.source()
        _prepared.clear()
        _prepared[recipe.token] = source
    rows = []
    for index in chunk.rows:
        with _limit_time(recipe.row_seconds):
            rows.append(make_row(source, recipe.seed, index, chunk.only_draw))
    return rows


def make_row(source: RowSource[Any], seed: int, index: int, only_draw: bool = False) -> Row:
    """Return one row, whatever its sampler and solver do short of ending the process.

    Any exception is the row's own failure: it is kept as its message, and the run goes on.
    """
    row_seed = derive_seed(seed, index)
    begin = time.perf_counter()
    parameters = None
    try:
        problem = source.draw(np.random.default_rng(row_seed))
        parameters = source.parameters(problem)
        if only_draw:
            return Row(index, row_seed, parameters, RowAnswer("failed"))
        begin = time.perf_counter()
        return Row(index, row_seed, parameters, source.solve(problem))
    except Exception as error:
        stage = "sampler" if parameters is None else "solver"
        message = f"{stage}: {type(error).__name__}: {error}".partition("\n")[0][:_MOST_WORDS]
        duration = time.perf_counter() - begin
        return Row(index, row_seed, parameters, RowAnswer("failed", message, time=duration))


@contextmanager
def _limit_time(seconds: float) -> Iterator[None]:
    """End this process if the block takes longer, even where it hangs in compiled code."""
    with Path(os.devnull).open("w") as nowhere:
        faulthandler.dump_traceback_later(seconds, exit=True, file=nowhere)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()


def _end_with(parent: int) -> None:
    """End this process when its parent is gone."""
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)
