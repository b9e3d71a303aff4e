"""Ctrl-C during HiGHS reaches the caller."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import highspy
import numpy as np
import pytest
from scipy import sparse

from climbplan.solvers.highs.model import build_linear_model, create_highs, run_highs


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    """Ctrl-C as in a program of its own."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def market_split(rows: int) -> Any:
    """Rows of weights to be split in half at once (Cornuejols and Dawande 1998): hard for trees."""
    weights = np.random.default_rng(0).integers(0, 100, (rows, 10 * (rows - 1))).astype(float)
    n = weights.shape[1]
    off = sparse.hstack([weights, sparse.identity(rows), -sparse.identity(rows)]).tocsr()
    cost = np.concatenate([np.zeros(n), np.ones(2 * rows)])
    upper = np.concatenate([np.ones(n), np.full(2 * rows, np.inf)])
    whole = np.concatenate([np.ones(n, bool), np.zeros(2 * rows, bool)])
    half = np.floor(weights.sum(axis=1) / 2)
    return build_linear_model(
        cost,
        off,
        lower=np.zeros(n + 2 * rows),
        upper=upper,
        integer=whole,
        row_lower=half,
        row_upper=half,
    )


def test_a_tree_search_is_stopped() -> None:
    solver = create_highs(300.0)
    solver.passModel(market_split(5))
    press = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    press.start()
    begin = time.process_time()
    with pytest.raises(KeyboardInterrupt):
        run_highs(solver)
    assert time.process_time() - begin < 5.0
    assert solver.getModelStatus() == highspy.HighsModelStatus.kInterrupt
    press.join()


def test_a_tree_search_ends_with_its_looks_at_the_same_place() -> None:
    ends = []
    for _ in range(2):
        solver = create_highs(300.0)
        solver.passModel(market_split(4))
        run_highs(solver, max_polls=60)
        assert solver.getModelStatus() == highspy.HighsModelStatus.kInterrupt
        info = solver.getInfo()
        ends.append((info.mip_node_count, info.simplex_iteration_count, info.mip_dual_bound))
    assert ends[0] == ends[1]


def test_a_search_that_does_not_look_up_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = create_highs(300.0)
    solver.passModel(market_split(5))
    woken = threading.Event()
    monkeypatch.setattr(solver, "run", lambda: woken.wait(30.0))  # as within a heuristic
    press = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    press.start()
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_highs(solver, patience=0.2)
    assert time.monotonic() - begin < 10.0
    woken.set()
    press.join()
