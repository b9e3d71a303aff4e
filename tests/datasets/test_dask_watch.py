"""A worker of Dask whose scheduler was killed ends soon, whatever its rows are at."""

from __future__ import annotations

import os
import threading
import time
from types import SimpleNamespace

import pytest

from climbplan.datasets import dask_engine


@pytest.fixture
def exits(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Exit codes of processes that would have ended; waits are short."""
    codes: list[int] = []
    monkeypatch.setattr(os, "_exit", codes.append)
    monkeypatch.setattr(dask_engine, "_LOOK", 0.01)
    monkeypatch.setattr(dask_engine, "_GRACE", 0.05)
    return codes


def watched(worker: object) -> tuple[threading.Event, threading.Thread]:
    """A watch over a worker, which runs until the event is set."""
    is_done = threading.Event()
    watch = threading.Thread(target=dask_engine._end_without_scheduler, args=(worker, is_done))
    watch.start()
    return is_done, watch


def test_a_worker_without_its_scheduler_ends(exits: list[int]) -> None:
    worker = SimpleNamespace(status=SimpleNamespace(name="running"))
    _, watch = watched(worker)
    time.sleep(0.1)
    assert watch.is_alive()
    assert not exits
    worker.status = SimpleNamespace(name="closing")
    watch.join(2.0)
    assert exits == [1]


def test_rows_that_are_done_in_time_end_nothing(exits: list[int]) -> None:
    is_done, watch = watched(SimpleNamespace(status=SimpleNamespace(name="closing")))
    is_done.set()
    watch.join(2.0)
    assert not exits


def test_the_words_are_those_of_dask() -> None:
    distributed = pytest.importorskip("distributed")
    names = {status.name for status in distributed.core.Status}
    assert set(dask_engine._CLOSING) <= names
    assert dask_engine._LOOK + dask_engine._GRACE < 5.0
