"""Libraries: strategies, files, and files that are not what they claim to be."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from small_programs import random_numbers, small_program

from climbplan.errors import PlanFileError, UsageError
from climbplan.learning.library import Library, ProgramSignature, read_library, write_library

PROGRAM = small_program(bilinear=True)
FRAME = ProgramSignature.of(PROGRAM)
ARRAYS = ("features", "points", "objective", "alternatives", "labels")


def _library(count: int = 12, labelled: bool = False) -> Library:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, len(FRAME.integer)))
    modes = rng.integers(3, size=count)
    points[:, FRAME.integer] = np.eye(3)[modes] + rng.uniform(-1e-4, 1e-4, (count, 3))
    sides = rng.integers(2, size=(count, 1))
    labels = np.arange(count)[:, None] % 2 if labelled else None
    theta = [random_numbers(rng) for _ in range(count)]
    features = np.array([np.concatenate(list(t.values())) for t in theta])
    return Library.of(FRAME, features, points, rng.uniform(size=count), sides, labels)


def test_strategies_are_unique_and_in_order_of_appearance() -> None:
    library = _library()
    labels = np.hstack([library.points[:, FRAME.integer] > 0.5, library.alternatives > 0])
    again = np.hstack([library.strategies, library.strategy_alternatives > 0])[library.strategy]
    assert (labels == again).all()
    assert len(np.unique(labels, axis=0)) == len(library.strategies)
    first = [int(np.flatnonzero(library.strategy == u)[0]) for u in range(len(library.strategies))]
    assert first == sorted(first)
    assert set(np.unique(library.points[:, FRAME.integer])) <= {0.0, 1.0}


def test_labels_tell_strategies_apart() -> None:
    plain, labelled = _library(), _library(labelled=True)
    assert len(labelled.strategies) > len(plain.strategies)
    assert (labelled.strategy_labels[labelled.strategy] == labelled.labels).all()


def test_subset_keeps_rows() -> None:
    library = _library()
    part = library.subset(np.array([3, 5]))
    assert part.size == 2
    assert (part.points == library.points[[3, 5]]).all()


def test_round_trip(tmp_path: Path) -> None:
    library = _library(labelled=True)
    path = tmp_path / "library.h5"
    write_library(library, path)
    again = read_library(path)
    for name in (*ARRAYS, "strategies", "strategy", "strategy_labels"):
        assert (vars(again)[name] == vars(library)[name]).all()
    again.require(PROGRAM, library.features.shape[1])


def test_another_program_is_refused() -> None:
    library = _library()
    with pytest.raises(UsageError, match="does not serve"):
        replace(library, frame=replace(FRAME, name="other")).require(PROGRAM)
    with pytest.raises(UsageError, match="features"):
        library.require(PROGRAM, 99)


@pytest.mark.parametrize("damage", ["nan", "fraction", "shape", "alternative"])
def test_arrays_that_are_no_solutions_are_refused(damage: str) -> None:
    library = _library()
    points, alternatives = library.points.copy(), library.alternatives.copy()
    features = library.features
    if damage == "nan":
        points[0, 0] = np.nan
    elif damage == "fraction":
        points[0, FRAME.integer] = 0.5
    elif damage == "shape":
        features = features[:-1]
    else:
        alternatives[0, 0] = 2
    with pytest.raises(UsageError):
        Library.of(FRAME, features, points, library.objective, alternatives)


def _change(path: Path, name: str, value: Any) -> None:
    with h5py.File(path, "r+") as file:
        del file[name]
        file[name] = value


def _cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def _huge(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["points"]
        file.create_dataset("points", (10**9, len(FRAME.integer)), float, chunks=(1000, 6))


def _link(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["features"]
        file["features"] = h5py.ExternalLink("elsewhere.h5", "features")


DAMAGES = {
    "cut": _cut,
    "pickle": lambda path: path.write_bytes(pickle.dumps({"points": [1, 2]})),
    "huge": _huge,
    "link": _link,
    "nan": lambda path: _change(path, "features", np.full((12, 5), np.nan)),
    "shape": lambda path: _change(path, "points", np.zeros((3, 2))),
    "type": lambda path: _change(path, "objective", np.array([b"a"] * 12)),
    "opaque": lambda path: _change(path, "objective", np.void(b"cos\nsystem\n")),
    "alternative": lambda path: _change(path, "alternatives", np.full((12, 1), 9)),
    "negative": lambda path: _change(path, "alternatives", np.full((12, 1), -1)),
    "options": lambda path: _change(path, "options", np.array([0])),
    "binary": lambda path: _change(path, "points", np.full((12, len(FRAME.integer)), 0.4)),
    "range": lambda path: _change(path, "points", np.full((12, len(FRAME.integer)), 7.0)),
}


@pytest.mark.parametrize("damage", sorted(DAMAGES))
def test_hostile_files_are_refused_with_their_name(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "library.h5"
    write_library(_library(), path)
    DAMAGES[damage](path)
    with pytest.raises(PlanFileError, match=r"library\.h5"):
        read_library(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(PlanFileError, match="no such file"):
        read_library(tmp_path / "none.h5")
