"""Files of scenes: units, groups, damage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from bookshelf_scenes import PUBLISHED

from climbplan.bookshelf.plan.dataset_frame import build_frame
from climbplan.bookshelf.scene.scene_file import read_scenes, write_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf
from climbplan.errors import PlanFileError, UsageError
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_file import write_dataset_file

SHIPPED = Path(__file__).parents[2] / "specs" / "bookshelf_scenes.h5"


def _foreign(path: Path, units: str | None = "mm, rad", **groups: np.ndarray) -> Path:
    with h5py.File(path, "w") as file:
        for name, theta in groups.items():
            file[f"{name}/theta"] = theta
        if units is not None:
            file.attrs["units"] = units
    return path


def test_written_scenes_are_read_again(tmp_path: Path) -> None:
    scenes = Scenes.from_theta(PUBLISHED, "mm")
    write_scenes(scenes, tmp_path / "s.h5", {"seed": 3})
    again = read_scenes(tmp_path / "s.h5")
    np.testing.assert_array_equal(again.theta(), scenes.theta())
    with h5py.File(tmp_path / "s.h5") as file:
        assert file.attrs["format"] == "climbplan/scenes"
        assert file["scenes/theta"].attrs["units"] == "m, rad"


def test_units_of_a_foreign_file_hold(tmp_path: Path) -> None:
    path = _foreign(tmp_path / "f.h5", test_all=PUBLISHED, train=PUBLISHED[:1])
    scenes = read_scenes(path, "test_all")
    np.testing.assert_allclose(scenes.theta("mm"), PUBLISHED)
    assert len(read_scenes(path, "train")) == 1


def test_groups_are_named_when_there_is_a_choice(tmp_path: Path) -> None:
    path = _foreign(tmp_path / "f.h5", test_all=PUBLISHED, train=PUBLISHED)
    with pytest.raises(PlanFileError, match="there is 'test_all', 'train'"):
        read_scenes(path)
    with pytest.raises(PlanFileError, match=r"no group 'tst_all'.*did you mean 'test_all'"):
        read_scenes(path, "tst_all")


def test_units_that_are_no_lengths(tmp_path: Path) -> None:
    for units in (None, "inch"):
        with pytest.raises(PlanFileError, match="units"):
            read_scenes(_foreign(tmp_path / "u.h5", units, g=PUBLISHED))


def test_wrong_rows_are_named(tmp_path: Path) -> None:
    rows = PUBLISHED.copy()
    rows[3, 4] = np.nan
    with pytest.raises(UsageError, match="scene 3, book 0: width is nan"):
        read_scenes(_foreign(tmp_path / "n.h5", g=rows))
    with pytest.raises(UsageError, match="expected"):
        read_scenes(_foreign(tmp_path / "c.h5", g=rows[:, :-1]))


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("theta")
    for name in ("text.h5", "missing.h5"):
        with pytest.raises(PlanFileError):
            read_scenes(tmp_path / name)
    with h5py.File(tmp_path / "flat.h5", "w") as file:
        file["g/theta"] = np.arange(17.0)
        file.attrs["units"] = "mm"
    with pytest.raises(PlanFileError, match="shape"):
        read_scenes(tmp_path / "flat.h5")


def test_the_shipped_scenes() -> None:
    scenes = read_scenes(SHIPPED, "scenes")
    assert (len(scenes), scenes.count) == (40, 3)
    assert SHIPPED.stat().st_size < 50_000


def test_scenes_of_a_dataset(tmp_path: Path) -> None:
    """Rows whose scene could not be drawn are left out; other problems have no scenes."""
    path = tmp_path / "dataset.h5"
    scenes = Scenes.from_theta(np.array([[-40, 40, 0, 80, 20, 90, 30.0]]), "mm")
    rows = _rows(np.vstack([scenes.theta("m"), np.full((1, 7), np.nan)]))
    write_dataset_file(rows, path)
    found = read_scenes(path)
    np.testing.assert_allclose(found.theta("mm"), scenes.theta("mm"))
    with pytest.raises(PlanFileError, match="no groups"):
        read_scenes(path, "scenes")
    write_dataset_file(replace(rows, frame=replace(rows.frame, kind="program")), path)
    with pytest.raises(PlanFileError, match="another problem"):
        read_scenes(path)


def _rows(parameters: np.ndarray) -> Dataset:
    """Rows without answers."""
    frame = build_frame(1, Shelf(), "contact")
    count = len(parameters)
    return Dataset(
        frame=frame,
        parameters=parameters,
        feasible=np.zeros(count, bool),
        solution={
            name: np.full((count, *layout.shape[1:]), -1 if layout.kind == "int" else np.nan)
            for name, layout in frame.layouts.items()
        },
        integers=np.full((count, len(frame.integer_names)), -1),
        objective=np.full(count, np.nan),
        bound=np.full(count, -np.inf),
        time=np.zeros(count),
        seed=np.arange(count),
        row=np.arange(count),
        status=("failed",) * count,
        message=("stopped",) * count,
        name="rows",
        title="",
        spec_text="",
        spec_sha256="0" * 64,
        base_seed=0,
        timings={},
        solvers={},
    )
