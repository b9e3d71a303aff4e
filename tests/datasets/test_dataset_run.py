"""Runs: the same rows whoever makes them; lost workers cost a retry, then a failure row."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
import pytest
from toy_rows import FRAME, ToyRows, toy_recipe

from climbplan.datasets.engine import Done
from climbplan.datasets.local_engine import LocalEngine
from climbplan.datasets.recipe import Chunk, Recipe
from climbplan.datasets.run import Count, run_rows
from climbplan.datasets.shards import ShardStore
from climbplan.datasets.work import make_row, make_rows
from climbplan.errors import UsageError
from climbplan.reports.notebook import build_dataset_tables
from climbplan.store import atomic_file
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_row import build_dataset, derive_seed

COUNT = 40


class Inline:
    """Workers that are function calls; some chunks are lost, and ends come in reverse order."""

    def __init__(self, recipe: Recipe, width: int = 3, lose: tuple[int, ...] = ()) -> None:
        self.recipe, self.width, self.lose = recipe, width, lose
        self.chunks: list[Chunk] = []
        self.asked: list[Chunk] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *details: object) -> None:
        pass

    def idle(self) -> bool:
        return len(self.chunks) < self.width

    def submit(self, chunk: Chunk) -> None:
        self.chunks.append(chunk)
        self.asked.append(chunk)

    def wait(self, seconds: float) -> list[Done]:
        done = []
        for chunk in reversed(self.chunks):
            lost = not chunk.only_draw and set(chunk.rows) & set(self.lose)
            if lost:
                done.append(Done(chunk, lost="its worker died (SIGKILL(-9))"))
            else:
                done.append(Done(chunk, tuple(make_rows(self.recipe, chunk))))
        self.chunks = []
        return done


def store(directory: Path, size: int = 7, count: int = COUNT) -> ShardStore:
    return ShardStore(directory, FRAME, "this run", count, size)


def expected() -> Dataset:
    return build_dataset(FRAME, [make_row(ToyRows(), 3, k) for k in range(COUNT)])


def assert_same(found: Dataset, wanted: Dataset, but: tuple[int, ...] = ()) -> None:
    """Equal in everything but times, and in all of some rows but their problem."""
    rows = np.setdiff1d(np.arange(wanted.count), but)
    np.testing.assert_array_equal(found.parameters, wanted.parameters)
    np.testing.assert_array_equal(found.seed, wanted.seed)
    np.testing.assert_array_equal(found.row, wanted.row)
    for name in ("feasible", "integers", "objective", "bound"):
        np.testing.assert_array_equal(vars(found)[name][rows], vars(wanted)[name][rows])
    np.testing.assert_array_equal(found.solution["x"][rows], wanted.solution["x"][rows])
    assert [found.status[k] for k in rows] == [wanted.status[k] for k in rows]
    assert [found.message[k] for k in rows] == [wanted.message[k] for k in rows]


def test_seeds_are_those_of_the_rows() -> None:
    seeds = [derive_seed(3, k) for k in range(1000)]
    assert len(set(seeds)) == 1000
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert derive_seed(3, 999) == seeds[999]
    assert derive_seed(4, 0) != seeds[0]


@pytest.mark.parametrize(("width", "size"), [(1, 7), (3, 7), (5, 1), (2, 100)])
def test_rows_do_not_depend_on_workers_order_and_shards(
    tmp_path: Path, width: int, size: int
) -> None:
    told: list[Count] = []
    shards = store(tmp_path, size)
    count = run_rows(shards, Inline(toy_recipe(), width), 3, report=told.append)
    wanted = expected()
    assert_same(shards.dataset(), wanted)
    assert count.done == count.total == COUNT
    assert count.answered == wanted.feasible.sum()
    assert 0 < wanted.feasible.sum() < COUNT  # some are infeasible, and rows all the same
    assert told[-1].done == COUNT


def test_a_lost_worker_costs_its_rows_one_retry_then_a_failure_row(tmp_path: Path) -> None:
    engine = Inline(toy_recipe(), 2, lose=(5, 20))
    shards = store(tmp_path)
    run_rows(shards, engine, 3)
    found = shards.dataset()
    assert_same(found, expected(), but=(5, 20))
    for row in (5, 20):
        assert found.status[row] == "failed"
        assert found.message[row] == "its worker died (SIGKILL(-9)), twice"
        assert not found.feasible[row]
        assert [c.attempt for c in engine.asked if row in c.rows] == [0, 1, 2]
        assert [c for c in engine.asked if row in c.rows][-1].only_draw


def test_rows_that_raise_are_rows(tmp_path: Path) -> None:
    shards = store(tmp_path)
    run_rows(shards, Inline(toy_recipe({"solve": "raise"})), 3)
    found = shards.dataset()
    bad = expected().parameters[:, 0] < 0.15
    assert bad.any()
    np.testing.assert_array_equal(found.parameters, expected().parameters)
    assert {found.status[k] for k in np.flatnonzero(bad)} == {"failed"}
    assert found.message[int(np.argmax(bad))] == "solver: ValueError: told to raise"
    shards = store(tmp_path / "draw")
    (tmp_path / "draw").mkdir()
    run_rows(shards, Inline(toy_recipe({"draw": "raise"})), 3)
    found = shards.dataset()
    assert np.isnan(found.parameters[bad]).all()
    assert np.isfinite(found.parameters[~bad]).all()
    assert found.message[int(np.argmax(bad))] == "sampler: ValueError: told to raise"


def test_resumed_rows_are_those_of_an_undisturbed_run(tmp_path: Path) -> None:
    class Stops(Inline):
        def wait(self, seconds: float) -> list[Done]:
            if len(self.asked) > 8:
                raise KeyboardInterrupt
            return super().wait(seconds)

    with pytest.raises(KeyboardInterrupt):
        run_rows(store(tmp_path), Stops(toy_recipe()), 3)
    again = store(tmp_path)
    found = again.find()
    assert 0 < len(found.rows) < COUNT
    engine = Inline(toy_recipe())
    count = run_rows(again, engine, 3, found.rows, found.answered)
    assert not {row for chunk in engine.asked for row in chunk.rows} & found.rows
    assert_same(again.dataset(), expected())
    assert count.answered == expected().feasible.sum()


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "header", "foreign"])
def test_damaged_shards_are_named_and_made_again(tmp_path: Path, damage: str) -> None:
    shards = store(tmp_path)
    run_rows(shards, Inline(toy_recipe()), 3)
    path = tmp_path / "rows_00000007_00000013.shard"
    content = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "header":
        path.write_bytes(b"no shard\n" + content)
    else:
        other = ShardStore(tmp_path / "other", FRAME, "another run", COUNT, 7)
        other.directory.mkdir()
        run_rows(other, Inline(toy_recipe()), 3)
        path.write_bytes((other.directory / path.name).read_bytes())
    again = store(tmp_path)
    found = again.find()
    assert len(found.damaged) == 1
    assert "rows_00000007_00000013.shard (rows 7 to 13)" in found.damaged[0]
    assert found.rows == frozenset(range(COUNT)) - frozenset(range(7, 14))
    run_rows(again, Inline(toy_recipe()), 3, found.rows, found.answered)
    assert_same(again.dataset(), expected())


def test_a_full_disk_ends_the_run_and_keeps_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, calls = atomic_file._flush, []

    def full(path: Path) -> None:
        calls.append(path)
        if len(calls) > 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(path)

    monkeypatch.setattr(atomic_file, "_flush", full)
    with pytest.raises(UsageError, match="No space left on device"):
        run_rows(store(tmp_path), Inline(toy_recipe()), 3)
    monkeypatch.undo()
    assert {p.suffix for p in tmp_path.iterdir()} == {".shard"}  # nothing half written
    again = store(tmp_path)
    found = again.find()
    assert found.rows
    assert not found.damaged
    run_rows(again, Inline(toy_recipe()), 3, found.rows, found.answered)
    assert_same(again.dataset(), expected())


def test_workers_that_die_or_hang_cost_their_row_only(tmp_path: Path) -> None:
    """Real processes: a killer row in the solver, and one in the sampler."""
    wanted = expected()
    bad = tuple(int(k) for k in np.flatnonzero(wanted.parameters[:, 0] < 0.05))
    assert len(bad) == 1
    shards = store(tmp_path)
    recipe = toy_recipe({"solve": "die"}, 0.05)
    with LocalEngine(recipe, 2) as engine:
        run_rows(shards, engine, 3)
    found = shards.dataset()
    assert_same(found, wanted, but=bad)
    assert {found.message[k] for k in bad} == {"its worker died (SIGKILL(-9)), twice"}
    assert np.isfinite(found.parameters[list(bad)]).all()


def test_a_worker_that_hangs_is_ended(tmp_path: Path) -> None:
    wanted = expected()
    bad = tuple(int(k) for k in np.flatnonzero(wanted.parameters[:, 0] < 0.05))
    assert len(bad) == 1
    shards = store(tmp_path)
    recipe = toy_recipe({"solve": "hang"}, 0.05, seconds=0.5)
    with LocalEngine(recipe, 1) as engine:
        run_rows(shards, engine, 3)
    found = shards.dataset()
    assert_same(found, wanted, but=bad)
    assert found.message[bad[0]] == "its worker died (EXIT(1)), twice"


def test_a_worker_lost_by_chance_changes_no_row(tmp_path: Path) -> None:
    marks = tmp_path / "marks"
    marks.mkdir()
    recipe = toy_recipe({"draw": "die"}, 0.05, once=marks)
    shards = store(tmp_path)
    with LocalEngine(recipe, 1) as engine:
        run_rows(shards, engine, 3)
    assert any(marks.iterdir())
    assert_same(shards.dataset(), expected())


def test_what_no_worker_can_start_with_ends_the_run(tmp_path: Path) -> None:
    recipe = replace(toy_recipe(), source=_impossible, token="impossible")
    with LocalEngine(recipe, 1) as engine, pytest.raises(UsageError, match="nothing to solve with"):
        run_rows(store(tmp_path), engine, 3)


def _impossible() -> ToyRows:
    raise UsageError("nothing to solve with")


def test_a_notebook_shows_how_rows_ended_and_the_first_ones() -> None:
    data = expected()
    page = build_dataset_tables(data)
    answered = int(data.feasible.sum())
    assert f"toy: {COUNT} rows, {answered} answered" in page
    assert f"{answered} optimal, {COUNT - answered} infeasible" in page
    assert page.count("<tr>") == 3 + 6  # cost and time, and five rows, each with a head
    assert f"<td>{np.median(data.objective[data.feasible]):.4g}</td>" in page
    assert "nan" not in page
