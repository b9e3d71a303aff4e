"""Runs that are killed again and again: what was made is kept, and all rows are undisturbed.

`CLIMBPLAN_KILLS=20 pytest tests/datasets/test_killed_runs.py` kills a run 20 times.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from test_dataset_run import COUNT, Inline, assert_same, expected
from toy_rows import FRAME, ToyRows

from climbplan.arrays import Array
from climbplan.datasets import shards
from climbplan.datasets.recipe import Recipe
from climbplan.datasets.run import run_rows
from climbplan.datasets.shards import ShardStore
from climbplan.datasets.work import make_row
from climbplan.store.dataset_row import RowAnswer

KILLS = int(os.environ.get("CLIMBPLAN_KILLS", "3"))
ROW_SECONDS = 0.01


@dataclass
class SlowRows(ToyRows):
    """Toy rows that take time."""

    def solve(self, drawn: Array) -> RowAnswer:
        time.sleep(ROW_SECONDS)
        return super().solve(drawn)


def store(directory: Path, size: int) -> ShardStore:
    return ShardStore(directory, FRAME, "this run", COUNT, size)


def resume(directory: Path, size: int) -> None:
    """Go on with a run until it is complete."""
    rows = store(directory, size)
    found = rows.find()
    assert not found.damaged
    recipe = Recipe(SlowRows, 3, 60.0, "slow rows")
    run_rows(rows, Inline(recipe, width=1), 3, found.rows, found.answered)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("size", [7, 100])
def test_killed_runs_keep_their_rows(tmp_path: Path, size: int) -> None:
    """Shards of 7 rows, and one that is never complete before the end."""
    rng = np.random.default_rng(11)
    fork = multiprocessing.get_context("fork")
    kept = [0]
    for kill in range(KILLS):
        run = fork.Process(target=resume, args=(tmp_path, size))
        run.start()
        while kill == 0 and run.is_alive() and not list(tmp_path.glob("*.shard")):
            time.sleep(0.001)
        time.sleep(float(rng.uniform(0.0, 2 * COUNT * ROW_SECONDS / KILLS)))
        run.kill()
        run.join()
        found = store(tmp_path, size).find()
        assert not found.damaged
        kept.append(len(found.rows))
    assert kept == sorted(kept)
    assert kept[1] > 0
    resume(tmp_path, size)
    assert_same(store(tmp_path, size).dataset(), expected())


def test_the_first_row_is_kept_at_once(tmp_path: Path) -> None:
    rows = ShardStore(tmp_path, FRAME, "this run", COUNT, COUNT)
    rows.add([make_row(ToyRows(), 3, 0)])
    assert ShardStore(tmp_path, FRAME, "this run", COUNT, COUNT).find().rows == {0}


def test_writing_incomplete_shards_takes_little_of_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(shards.time, "monotonic", lambda: now[0])
    rows = ShardStore(tmp_path, FRAME, "this run", COUNT, COUNT)
    written: list[int] = []

    def write(shard: int) -> None:
        written.append(shard)
        now[0] += 0.1
        rows._unsaved.discard(shard)

    monkeypatch.setattr(rows, "_write", write)
    for index in range(COUNT - 1):
        now[0] += 0.2
        rows.add([make_row(ToyRows(), 3, index)])
    assert len(written) >= 2
    assert 0.1 * len(written) < 0.1 * now[0]
