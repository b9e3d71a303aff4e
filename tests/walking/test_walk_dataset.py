"""Walks as rows of a dataset, and the library that comes from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.datasets.verification import verify
from climbplan.datasets.work import make_row
from climbplan.errors import PlanFileError, UsageError
from climbplan.plans.dataset import Dataset
from climbplan.plans.dataset_file import write_dataset_file
from climbplan.plans.dataset_row import dataset_of
from climbplan.spec.datasets.walks import WalksProblemSpec
from climbplan.spec.walking.loading import load_body
from climbplan.walking.check.checker import check_trajectory, failures
from climbplan.walking.dataset_rows import WalkRows, task_of_frame, walk_of
from climbplan.walking.online.dataset_library import is_dataset, library_of_dataset
from climbplan.walking.online.library import SECTION
from climbplan.walking.online.run import library_key
from climbplan.walking.problem import build_task

SPEC = WalksProblemSpec.model_validate(
    {
        "kind": "mpc",
        "task": {
            "knots": 6,
            "integrator": "mean",
            "whole_stance": False,
            "least_contacts": 2,
        },
        "solver": {"qps": 30},
    }
)


@pytest.fixture(scope="module")
def walks() -> Dataset:
    source = WalkRows(SPEC, load_body("scaler"))
    rows = [make_row(source, 3, index) for index in range(3)]
    again = make_row(WalkRows(SPEC, load_body("scaler")), 3, 1)
    assert again.answer.objective == rows[1].answer.objective
    assert np.array_equal(again.parameters, rows[1].parameters)
    return dataset_of(source.frame, rows)


def test_rows_hold_walks_from_their_starts(walks: Dataset) -> None:
    task = task_of_frame(walks.frame, Path("here"))
    assert library_key(task) == library_key(build_task(SPEC.walk, load_body("scaler")))
    assert walks.feasible.any()
    for row in np.flatnonzero(walks.feasible):
        own, found = walk_of(task, walks, int(row))
        assert not failures(check_trajectory(own, found))
        drawn = walks.parameters[row]
        assert own.start.state[3] == pytest.approx(drawn[0] + 0.08 * drawn[1])
        assert abs(drawn[0]) <= 1.5
        assert abs(drawn[1]) <= 15


def test_a_file_is_verified_and_serves_as_library(walks: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "dataset.h5"
    write_dataset_file(walks, path)
    found = verify(path)
    assert {c.name for c in found.checks if not c.passed} <= {"file.spec_hash"}
    assert "workspace at knots" in found.model  # as in every walk of these
    assert is_dataset(path)
    key = library_key(task_of_frame(walks.frame, path))
    library = library_of_dataset(path, key, library_key)
    answered = int(walks.feasible.sum())
    assert library.walks == answered
    assert len(library) == 2 * answered * (6 - SECTION + 1)  # with mirror images
    with pytest.raises(UsageError, match="another robot"):
        library_of_dataset(path, "other", library_key)


def test_a_spoilt_walk_is_found(walks: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "dataset.h5"
    row = int(np.flatnonzero(walks.feasible)[0])
    force = np.array(walks.solution["force"])
    force[row, 2, :, 0] += 1.0
    write_dataset_file(replace(walks, solution={**walks.solution, "force": force}), path)
    failed = {check.name for check in verify(path).checks if not check.passed}
    assert "rows.walks" in failed
    other = replace(walks, frame=replace(walks.frame, facts={"body": 3}))
    with pytest.raises(PlanFileError, match="not those of a walking task"):
        task_of_frame(other.frame, path)
