"""Dataset files: read as written; files that lie, or are damaged, are refused with a clear word."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.errors import PlanFileError, UsageError
from climbplan.store.dataset import Dataset, DatasetFrame, build_solution_layout
from climbplan.store.dataset_file import read_dataset_file, write_dataset_file
from climbplan.store.dataset_statistics import compute_statistics, format_statistics

FRAME = DatasetFrame(
    kind="toy",
    problem="toy",
    facts={"size": 2, "shelf": {"left": -0.1}},
    parameter_names=("a", "b"),
    integer_names=("sign",),
    layouts={"x": build_solution_layout((3,), "m"), "y": build_solution_layout((), kind="int")},
    objective_unit="mm^2",
)


def example() -> Dataset:
    """Six rows: two without an answer, of which one could not even be drawn."""
    parameters = np.random.default_rng(0).uniform(size=(6, 2))
    parameters[5] = np.nan
    feasible = np.array([True, True, True, True, False, False])
    x = np.where(feasible[:, None], 1.5, np.nan) * np.ones((6, 3))
    return Dataset(
        frame=FRAME,
        parameters=parameters,
        feasible=feasible,
        solution={"x": x, "y": np.where(feasible, 2, -1)},
        integers=np.where(feasible, [1, 1, 0, 1, 0, 0], -1)[:, None],
        objective=np.where(feasible, [1.0, 2.0, 3.0, 4.0, 0.0, 0.0], np.nan),
        bound=np.array([1.0, 2.0, -np.inf, 4.0, np.inf, -np.inf]),
        time=np.full(6, 0.25),
        seed=np.arange(6) + 2**60,
        row=np.arange(6),
        status=("optimal", "optimal", "feasible", "optimal", "infeasible", "failed"),
        message=("", "", "gap open", "", "too wide", "sampler: no"),
        name="six",
        title="Sechs Zeilen: ä",
        spec_text="kind: dataset\n",
        spec_sha256="0" * 64,
        base_seed=7,
        timings={"rows": 1.5},
        solvers={"method": "none"},
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "dataset.h5"
    write_dataset_file(example(), path)
    return path


def assert_equal(found: Dataset, wanted: Dataset) -> None:
    for name, value in vars(wanted).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(vars(found)[name], value)
        elif name not in ("solution", "created", "climbplan_version"):
            assert vars(found)[name] == value, name
    for name, value in wanted.solution.items():
        np.testing.assert_array_equal(found.solution[name], value)


def test_read_as_written(path: Path) -> None:
    found = read_dataset_file(path)
    assert_equal(found, example())
    assert found.created
    assert found.overall == "feasible"
    with h5py.File(path) as file:
        assert file.attrs["format"] == "climbplan/dataset"
        assert file.attrs["problem"] == "toy"
        assert file["objective"].attrs["units"] == "mm^2"
        assert file["solution/x"].attrs["units"] == "m"


def test_masks_are_kept(path: Path) -> None:
    test = np.array([1, 0, 0, 0, 0, 0], bool)
    data = replace(example(), train=~test, test=test)
    write_dataset_file(data, path)
    assert_equal(read_dataset_file(path), data)


def test_rows_and_joined() -> None:
    data = example()
    parts = [data.rows(np.array([0, 1, 2])), data.rows(np.array([3, 4, 5]))]
    assert_equal(Dataset.join(parts), data)
    other = replace(data, frame=replace(FRAME, facts={"size": 3, "shelf": {"left": -0.1}}))
    with pytest.raises(UsageError, match="another size: 3, expected 2"):
        Dataset.join([data, other])


def test_equal_problems_have_equal_hashes() -> None:
    data = example()
    parameters = data.parameters.copy()
    parameters[3] = parameters[0]
    hashes = replace(data, parameters=parameters).hashes()
    assert hashes[3] == hashes[0]
    assert len(set(hashes)) == 5


def test_statistics() -> None:
    figures = compute_statistics(example())
    assert figures["rows"]["answered"] == 4
    assert figures["rows"]["not_drawn"] == 1
    assert figures["cost"]["mean"] == 2.5
    assert figures["strategies"]["distinct"] == 2
    assert figures["reasons"] == {"too wide": 1, "sampler: no": 1}
    lines = format_statistics(example())
    assert any(line.endswith("3 optimal, 1 feasible, 1 infeasible, 1 failed") for line in lines)


def _set(name: str, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = value
        file[name].attrs["units"] = ""

    return change


def _attribute(name: str, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file.attrs[name] = value

    return change


def _huge(file: h5py.File) -> None:
    del file["parameters"]
    file.create_dataset("parameters", (2**40, 2), chunks=(1024, 2), dtype=float)


def _nan_answer(file: h5py.File) -> None:
    file["solution/x"][1, 2] = np.nan


def _object_layout(file: h5py.File) -> None:
    text = '{"x": {"shape": [3], "units": "", "frame": "", "kind": "object"}}'
    file.attrs["solution_layout"] = text


def _link(file: h5py.File) -> None:
    del file["objective"]
    file["objective"] = h5py.ExternalLink("/etc/hostname", "/")


def _overlap(file: h5py.File) -> None:
    split = file.create_group("split")
    split["train"] = split["test"] = np.ones(6, bool)


def _no_rows(file: h5py.File) -> None:
    for holder in (file, file["solution"]):
        for name, item in list(holder.items()):
            if isinstance(item, h5py.Dataset) and item.shape[:1] == (6,):
                kept, units, dtype = item[:0], dict(item.attrs), item.dtype
                del holder[name]
                holder.create_dataset(name, data=kept, dtype=dtype).attrs.update(units)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (_no_rows, "no rows"),
        (_set("objective", np.full(6, -1e308)), "objective holds numbers beyond 1e.30"),
        (_attribute("facts", '{"right": 1e999}'), "attribute facts: the number .* is out of range"),
        (_attribute("format", "climbplan/climb"), "not a dataset"),
        (_attribute("format_version", 9), "format version 9"),
        (_set("parameters", np.zeros((5, 2))), "shape"),
        (_set("parameters", np.full((6, 2), np.inf)), "infinite"),
        (_set("parameters", np.array([[b"x", b"y"]] * 6)), "expected float"),
        (_set("objective", np.full(6, np.nan)), "objective is not finite"),
        (_set("feasible", np.ones(6, bool)), "disagree"),
        (_set("time", np.full(6, -1.0)), "negative time"),
        (_set("time", np.full(6, np.nan)), "not finite"),
        (_set("integers", np.zeros((6, 4), int)), "shape"),
        (_huge, "claims shape"),
        (_nan_answer, "solution/x is not finite"),
        (_object_layout, "kind of 'x' is 'object'"),
        (_attribute("solution_layout", '{"../x": {}}'), "does not describe an array"),
        (_attribute("solution_layout", '{"x": {"shape": [-3]}}'), "shape of 'x'"),
        (_attribute("solution_layout", "[]"), "not a JSON object"),
        (_attribute("facts", "gASVAAAA"), "not JSON"),
        (_link, "is a link"),
        (_overlap, "both train and test"),
    ],
)
def test_hostile_files_are_refused(
    path: Path, change: Callable[[h5py.File], None], word: str
) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(PlanFileError, match=word) as caught:
        read_dataset_file(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_files_cut_short_are_refused(path: Path, share: float) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(PlanFileError):
        read_dataset_file(path)
