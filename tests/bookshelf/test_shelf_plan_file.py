"""Bookshelf plan files: read back exactly, tampered with, and not plans at all."""

from __future__ import annotations

import hashlib
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from climbplan.bookshelf.check.plan_checks import LIMITS, MEANINGS
from climbplan.bookshelf.check.verification import report_published_overlap, verify, verify_and_mark
from climbplan.bookshelf.plan.file import read_shelf_plan, write_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, combine_statuses
from climbplan.bookshelf.planner.runs import run_shelf
from climbplan.bookshelf.scene.scene_file import write_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes
from climbplan.bookshelf.schema.loading import load_shelf
from climbplan.errors import PlanFileError

Change = Callable[[h5py.File], None]

# Scene 0 needs room, scene 1 has room, scene 2 can have none; x, y, angle, height, width in mm.
ROWS = np.array(
    [
        [-68.1, 34, 0, 68, 26, -22.7, 11.5, -math.pi / 2, 57, 23, 90, 80],
        [-68.1, 34, 0, 68, 26, 0, 11.5, -math.pi / 2, 57, 23, 65, 17],
        [-68.1, 34, 0, 68, 26, 0, 11.5, -math.pi / 2, 57, 23, 65, 150],
    ]
)
INFEASIBLE = 2
SPEC = "kind: bookshelf\nscenes: {file: scenes.h5}\n"


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> ShelfPlan:
    place = tmp_path_factory.mktemp("shelf")
    write_scenes(Scenes.from_theta(ROWS, "mm"), place / "scenes.h5", {})
    (place / "spec.yaml").write_text(SPEC)
    return run_shelf(load_shelf(place / "spec.yaml"))


@pytest.fixture
def path(plan: ShelfPlan, tmp_path: Path) -> Path:
    file = tmp_path / "plan.h5"
    write_shelf_plan(plan, file)
    return file


def failed(path: Path) -> set[str]:
    return {check.name for check in verify(path).failed}


def test_round_trip(plan: ShelfPlan, path: Path) -> None:
    found = read_shelf_plan(path)
    assert found.solutions.status == ("optimal", "optimal", "infeasible")
    for name, value in vars(plan.solutions).items():
        np.testing.assert_array_equal(vars(found.solutions)[name], value, err_msg=name)
    np.testing.assert_array_equal(found.scenes.theta(), plan.scenes.theta())
    assert found.shelf == plan.shelf
    assert found.totals == plan.totals
    assert (found.summary, found.timings, found.sizes) == (plan.summary, plan.timings, plan.sizes)
    assert found.created.startswith("20")
    again = path.with_name("again.h5")
    write_shelf_plan(found, again)
    assert read_shelf_plan(again).created == found.created


def test_what_is_written_verifies(path: Path) -> None:
    assert not read_shelf_plan(path).verified
    verification = verify_and_mark(path)
    assert verification.passed, verification.table()
    assert read_shelf_plan(path).verified
    assert {check.name for check in verification.checks} == set(LIMITS) | {
        name for name in MEANINGS if name not in ("book.inside", "book.rotation", "book.separation")
    }


def test_the_published_meaning_says_how_far_books_overlap(plan: ShelfPlan) -> None:
    pose = plan.solutions.pose.copy()
    row = int(np.flatnonzero(plan.solutions.placed)[0])
    pose[row, 1] = pose[row, 0]  # two books in one place
    pushed = replace(plan, solutions=replace(plan.solutions, pose=pose))
    assert report_published_overlap(pushed) == ()  # the meaning `contact` judges it
    (left,) = report_published_overlap(replace(pushed, meaning="published"))
    assert left.model == "published meaning"
    assert left.words.startswith("books overlap by up to ")
    assert report_published_overlap(replace(plan, meaning="published")) == ()


def test_every_dataset_has_units(path: Path) -> None:
    def look(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            assert isinstance(item.attrs["units"], str), name

    with h5py.File(path) as file:
        file.visititems(look)
        assert file["solution/pose"].shape == (3, 3, 3)
        assert file.attrs["format"] == "climbplan/bookshelf"
        assert "sum of the movement costs" in file.attrs["objective_is"]
        total = file["solution/objective"][:2].sum()
        assert file.attrs["objective"] == pytest.approx(total)
        assert file.attrs["gap"] == pytest.approx(file.attrs["objective"] - file.attrs["bound"])


@pytest.mark.parametrize(
    ("statuses", "whole"),
    [
        (["optimal", "optimal"], "optimal"),
        (["optimal", "infeasible"], "optimal"),
        (["optimal", "feasible", "infeasible"], "feasible"),
        (["infeasible", "infeasible"], "infeasible"),
        (["optimal", "feasible", "infeasible", "limit"], "limit"),
    ],
)
def test_one_status_of_all(statuses: list[str], whole: str) -> None:
    assert combine_statuses(statuses) == whole


def put(name: str, index: Any, value: Any) -> Change:
    return lambda file: file[name].__setitem__(index, value)


def add(name: str, index: Any, value: Any) -> Change:
    return lambda file: file[name].__setitem__(index, file[name][index] + value)


def attribute(group: str, name: str, value: Any) -> Change:
    return lambda file: file[group].attrs.__setitem__(name, value)


def spec_with(old: str, new: str) -> Change:
    def change(file: h5py.File) -> None:
        text = file.attrs["spec"].replace(old, new)
        assert text != file.attrs["spec"]
        file.attrs["spec"] = text
        file.attrs["spec_sha256"] = hashlib.sha256(text.encode()).hexdigest()

    return change


def say_infeasible(file: h5py.File) -> None:
    """Scene 1, which has room, loses its placement."""
    for name, value in (
        ("pose", math.nan), ("state", -1), ("slot", -1), ("status", "infeasible"),
        ("objective", math.inf), ("bound", math.inf), ("overlap", math.nan),
    ):  # fmt: skip
        file[f"solution/{name}"][1] = value


# What is changed, checks that must notice, checks that may.
TAMPERED: dict[str, tuple[Change, set[str], set[str]]] = {
    "stored book moved": (
        add("solution/pose", (1, 1, 0), 1e-3),
        {"file.objective"},
        {"solution.bound"},
    ),
    "stored book into a wall": (
        add("solution/pose", (1, 0, 0), -0.02),
        {"file.objective", "book.wall"},
        set(),
    ),
    "inserted book into another": (
        lambda file: put("solution/pose", (1, 2, 0), file["solution/pose"][1, 1, 0])(file),
        {"book.overlap", "solution.overlap"},
        {"solution.slot"},
    ),
    "inserted book lifted": (add("solution/pose", (0, 2, 1), 1e-3), {"book.ground"}, set()),
    "inserted book above the shelf": (
        add("solution/pose", (0, 2, 1), 0.1),
        {"book.ground", "book.clear_height"},
        set(),
    ),
    "state": (put("solution/state", (0, 0), 1), {"book.stability"}, {"book.support"}),
    "state that is none": (
        put("solution/state", (0, 0), 7),
        {"solution.consistency", "book.state"},
        set(),
    ),
    "angle": (
        add("solution/pose", (0, 2, 2), 0.01),
        {"book.state"},
        {"book.overlap", "book.wall", "book.ground", "solution.overlap"},
    ),
    "objective of a scene": (
        add("solution/objective", 0, 1.0),
        {"file.objective", "file.totals"},
        {"solution.gap"},
    ),
    "objective of all": (
        lambda file: file.attrs.__setitem__("objective", 0.0),
        {"file.totals"},
        set(),
    ),
    "status of all": (attribute("/", "status", "infeasible"), {"file.totals"}, set()),
    "status of a scene": (
        put("solution/status", 0, "limit"),
        {"solution.consistency", "file.totals"},
        set(),
    ),
    "bound above the cost": (
        add("solution/bound", 0, 5.0),
        {"solution.bound", "file.totals"},
        set(),
    ),
    "optimal with an open gap": (
        add("solution/bound", 0, -5.0),
        {"solution.gap", "file.totals"},
        set(),
    ),
    "overlap": (put("solution/overlap", 0, 1e-3), {"solution.overlap"}, set()),
    "slot": (add("solution/slot", 0, 1), {"solution.slot"}, {"solution.consistency"}),
    "infeasible scene with a cost": (
        put("solution/objective", INFEASIBLE, 1.0),
        {"solution.consistency"},
        set(),
    ),
    "scene with room said to be infeasible": (
        say_infeasible,
        {"solution.infeasible"},
        {"file.totals"},
    ),
    "pose of a part": (
        put("solution/pose", (0, 1, 1), math.nan),
        {"solution.consistency", "file.totals"},
        set(),
    ),
    "stored scene": (
        add("scenes/theta", (1, 0), 1e-3),
        {"file.objective"},
        {"solution.bound"},
    ),
    "stored scene with NaN": (
        put("scenes/theta", (1, 0), math.nan),
        {"file.finite", "scenes.data"},
        set(),
    ),
    "book without width": (put("scenes/theta", (1, 4), 0.0), {"scenes.data"}, set()),
    "time": (put("solution/time", 0, math.nan), {"file.finite"}, set()),
    "wider shelf": (
        attribute("shelf", "right", 1.0),
        {"file.spec_values"},
        {"solution.infeasible"},
    ),
    "spec text": (attribute("/", "spec", SPEC + "seed: 0\n"), {"file.spec_hash"}, set()),
    "another spec": (
        spec_with("kind: bookshelf", "kind: bookshelf\nshelf: {max_book_gap_mm: 9}"),
        {"file.spec_values"},
        set(),
    ),
    "no spec": (spec_with("kind: bookshelf", "kind: climb"), {"file.spec_values"}, set()),
    "seed": (attribute("/", "seed", 5), {"file.spec_values"}, set()),
    "method": (attribute("/", "method", "mccormick"), {"file.spec_values"}, set()),
}  # fmt: skip


def test_a_plan_with_old_names_of_method_and_keys_verifies(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        spec_with("kind: bookshelf", "kind: bookshelf\nmeaning: contact")(file)
        attribute("/", "method", "micp")(file)
        spec_with("kind: bookshelf", "kind: bookshelf\nsolver: {method: micp}")(file)
    assert read_shelf_plan(path).method == "mccormick"
    assert verify(path).passed


@pytest.mark.parametrize("name", TAMPERED)
def test_tampering_is_noticed(path: Path, name: str) -> None:
    change, must, may = TAMPERED[name]
    with h5py.File(path, "r+") as file:
        change(file)
    noticed = failed(path)
    assert must <= noticed
    assert noticed <= must | may


def test_an_inline_scene_is_the_specs(plan: ShelfPlan, path: Path, tmp_path: Path) -> None:
    text = (
        "kind: bookshelf\nscene: {books: [{x_mm: 0, height_mm: 80, width_mm: 20}], "
        "insert: {height_mm: 70, width_mm: 30}}\n"
    )
    (tmp_path / "one.yaml").write_text(text)
    one = run_shelf(load_shelf(tmp_path / "one.yaml"))
    write_shelf_plan(one, path)
    assert verify(path).passed
    scenes = replace(one.scenes, pose=one.scenes.pose + np.array([1e-3, 0, 0]))
    write_shelf_plan(replace(one, scenes=scenes), path)
    assert "file.spec_values" in failed(path)


BROKEN: dict[str, tuple[Change, str]] = {
    "no format": (lambda file: file.attrs.__delitem__("format"), "no attribute `format`"),
    "another format": (attribute("/", "format", "climbplan/climb"), "holds 'climbplan/climb'"),
    "newer": (attribute("/", "format_version", 2), "a newer climbplan reads it"),
    "no theta": (lambda file: file.__delitem__("scenes/theta"), "scenes/theta is missing"),
    "no solution": (lambda file: file.__delitem__("solution"), "solution is missing"),
    "unknown status": (put("solution/status", 0, "fine"), "status 'fine', expected one of"),
    "unknown meaning": (attribute("/", "meaning", "mine"), "meaning 'mine', expected one of"),
    "shelf inside out": (attribute("shelf", "right", -1.0), "expected left < right"),
    "timings": (attribute("/", "timings", "[1]"), "attribute timings is not a JSON object"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused(path: Path, name: str) -> None:
    change, said = BROKEN[name]
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(PlanFileError, match=said):
        verify(path)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("scenes/theta", np.zeros((3, 11)), r"theta has shape \(3, 11\), expected"),
        ("scenes/theta", np.zeros((0, 12)), "expected"),
        ("scenes/theta", np.zeros((3, 17)), "solution/pose has shape"),
        ("scenes/theta", np.zeros((3, 12), "S3"), "expected float"),
        ("solution/state", np.zeros((3, 3)), "expected int"),
        ("solution/pose", np.zeros((2, 3, 3)), "expected"),
        ("solution/slot", np.zeros((4,), int), "expected"),
    ],
)
def test_misshapen_data_is_refused(path: Path, name: str, value: Any, said: str) -> None:
    with h5py.File(path, "r+") as file:
        del file[name]
        file[name] = value
    with pytest.raises(PlanFileError, match=said):
        verify(path)


def test_links_and_cut_files_are_refused(path: Path, tmp_path: Path) -> None:
    whole = Path(shutil.copy(path, tmp_path / "whole.h5"))
    with h5py.File(path, "r+") as file:
        del file["scenes"]
        file["scenes"] = h5py.ExternalLink(str(whole), "scenes")
    with pytest.raises(PlanFileError, match="is a link"):
        verify(path)
    content = whole.read_bytes()
    for length in (0, 7, 100, len(content) // 2, len(content) - 20):
        path.write_bytes(content[:length])
        with pytest.raises(PlanFileError):
            verify(path)


def test_flipped_bytes_never_crash(path: Path, tmp_path: Path) -> None:
    content = path.read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(150):
        damaged = bytearray(content)
        damaged[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
        (tmp_path / "d.h5").write_bytes(damaged)
        try:
            verify(tmp_path / "d.h5")
        except PlanFileError:
            continue


def test_nan_is_refused_outside_of_verification(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["solution/time"][0] = math.nan
    with pytest.raises(PlanFileError, match="NaN or infinity in solution/time"):
        read_shelf_plan(path)
