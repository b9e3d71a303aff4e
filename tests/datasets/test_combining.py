"""Merging, splitting and tables: a problem is never on both sides."""

from __future__ import annotations

import csv
import io
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_rows import FRAME, ToyRows

from climbplan.datasets.combining import merge, split
from climbplan.datasets.exports.table import build_columns, export_parquet, write_table
from climbplan.datasets.work import make_row
from climbplan.errors import MissingSolver, UsageError
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_row import build_dataset


def made(seed: int, count: int = 20) -> Dataset:
    rows = [make_row(ToyRows(), seed, k) for k in range(count)]
    return replace(build_dataset(FRAME, rows), name=f"seed {seed}", verified=True)


def test_merge_of_different_seeds() -> None:
    done = merge([("one", made(1)), ("two", made(2))])
    assert done.data.count == 40
    assert done.dropped == 0
    assert done.data.verified
    np.testing.assert_array_equal(done.data.parameters[20:], made(2).parameters)


def test_duplicates_are_refused_or_dropped() -> None:
    parts = [("one", made(1)), ("more", made(1, 30))]
    with pytest.raises(UsageError, match=r"20 rows .* first in more"):
        merge(parts)
    done = merge(parts, drop_duplicates=True)
    assert done.dropped == 20
    assert done.data.count == 30
    assert len(set(done.data.hashes())) == 30


def test_another_problem_is_refused() -> None:
    other = replace(made(2), frame=replace(FRAME, facts={"size": 4}))
    with pytest.raises(UsageError, match="two does not go with one: another size: 4, expected 2"):
        merge([("one", made(1)), ("two", other)])


def test_splits_share_no_problem() -> None:
    data = Dataset.join([made(1), made(2), made(1)])
    parameters = data.parameters.copy()
    parameters[3] = np.nan
    data = replace(data, parameters=parameters)
    masks = split(data, 0.3, seed=5)
    hashes = np.array(data.hashes())
    assert not set(hashes[masks.train]) & set(hashes[masks.test])
    assert not (masks.train & masks.test).any()
    np.testing.assert_array_equal(masks.train | masks.test, np.arange(60) != 3)
    assert len(set(hashes[masks.test])) == 12
    again = split(data, 0.3, seed=5)
    np.testing.assert_array_equal(again.test, masks.test)
    assert not np.array_equal(split(data, 0.3, seed=6).test, masks.test)


@pytest.mark.parametrize("share", [0.0, 1.0, -1.0, math.nan])
def test_shares_that_are_none_are_refused(share: float) -> None:
    with pytest.raises(UsageError, match="expected a share of more than 0 and less than 1"):
        split(made(1), share)


@pytest.mark.parametrize("share", [0.01, 0.99])
def test_empty_sides_are_refused(share: float) -> None:
    with pytest.raises(UsageError, match="cannot be split"):
        split(made(1), share)


def test_csv_holds_every_number_exactly() -> None:
    data = made(1)
    stream = io.StringIO()
    write_table(data, stream)
    lines = list(csv.DictReader(io.StringIO(stream.getvalue())))
    assert len(lines) == data.count
    for k, line in enumerate(lines):
        assert float(line["parameters.a"]) == data.parameters[k, 0]
        assert line["feasible"] == ("true" if data.feasible[k] else "false")
        assert line["status"] == data.status[k]
        expected = data.solution["x"][k, 1]
        assert (float(line["solution.x_1"]) if line["solution.x_1"] else None) == (
            expected if np.isfinite(expected) else None
        )


def test_parquet_holds_the_same_table(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    data = made(1)
    export_parquet(data, tmp_path / "data.parquet")
    table = parquet.read_table(tmp_path / "data.parquet")
    assert table.column_names == list(build_columns(data))
    np.testing.assert_array_equal(table["parameters.b"].to_numpy(), data.parameters[:, 1])
    assert table["status"].to_pylist() == list(data.status)
    assert table.schema.field("time").metadata[b"units"] == b"s"


def test_without_pyarrow_it_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingSolver, match=r"climbplan\[data\].*CSV"):
        export_parquet(made(1), tmp_path / "data.parquet")
