"""Walks as rows of a dataset, and the library that comes from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from climbplan.datasets.check.verification import verify
from climbplan.datasets.work import make_row
from climbplan.errors import PlanFileError, UsageError
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_file import read_dataset_file, write_dataset_file
from climbplan.store.dataset_row import build_dataset
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.online.dataset_rows import WalkRows, read_frame_task, read_walk
from climbplan.walking.online.features import feature_count
from climbplan.walking.online.library import SECTION, cut_sections
from climbplan.walking.online.run import compute_library_key, is_dataset, read_dataset_library
from climbplan.walking.problem.problem import build_task
from climbplan.walking.problem.random_tasks import NUM_TREADS, apply_world
from climbplan.walking.schema.dataset import WalksProblemSpec, WorldRangesSpec
from climbplan.walking.schema.loading import load_body
from climbplan.walking.task.task import Gait, WalkTrajectory

SPEC = WalksProblemSpec.model_validate(
    {
        "kind": "mpc",
        "task": {
            "knots": 6,
            "integrator": "mean",
            "workspace_over_stance": False,
            "min_contacts": 2,
        },
        "solver": {"max_qp_solves": 30},
    }
)


@pytest.fixture(scope="module")
def walks() -> Dataset:
    source = WalkRows(SPEC, load_body("scaler"))
    rows = [make_row(source, 3, index) for index in range(3)]
    again = make_row(WalkRows(SPEC, load_body("scaler")), 3, 1)
    assert again.answer.objective == rows[1].answer.objective
    assert np.array_equal(again.parameters, rows[1].parameters)
    return build_dataset(source.frame, rows)


def test_rows_hold_walks_from_their_starts(walks: Dataset) -> None:
    task = read_frame_task(walks.frame, Path("here"))
    assert compute_library_key(task) == compute_library_key(
        build_task(SPEC.walk, load_body("scaler"))
    )
    assert walks.feasible.any()
    for row in np.flatnonzero(walks.feasible):
        own, found = read_walk(task, walks, int(row))
        assert not format_failures(check_trajectory(own, found))
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
    key = compute_library_key(read_frame_task(walks.frame, path))
    library = read_dataset_library(path, key, compute_library_key)
    answered = int(walks.feasible.sum())
    assert library.walks == answered
    assert len(library) == 2 * answered * (6 - SECTION + 1)  # with mirror images
    with pytest.raises(UsageError, match="another robot"):
        read_dataset_library(path, "other", compute_library_key)


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
        read_frame_task(other.frame, path)


FLAT = np.concatenate([np.ones(2 * NUM_TREADS), np.zeros(2 * NUM_TREADS)])
RANGES = WorldRangesSpec(mass=0.3, speed=(0.3, 1.0), rise=0.05, tread=(0.15, 0.3))
WORLDS = SPEC.model_copy(update={"randomisation": RANGES})


@pytest.fixture(scope="module")
def worlds() -> Dataset:
    source = WalkRows(WORLDS, load_body("scaler"))
    return build_dataset(source.frame, [make_row(source, 3, index) for index in range(3)])


def test_walks_in_worlds_of_their_own_are_read_back(worlds: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "dataset.h5"
    write_dataset_file(worlds, path)
    data = read_dataset_file(path)
    task = read_frame_task(data.frame, path)
    rows = np.flatnonzero(data.feasible).tolist()
    assert rows
    for row in rows:
        own, found = read_walk(task, data, row)
        assert own.ground.count == 2 * NUM_TREADS + 1
        assert not format_failures(check_trajectory(own, found))
        standing = found.gait.contact[0]
        assert np.allclose(own.start.toes[standing], found.toes[0, standing])
    factor = data.parameters[:, data.frame.parameter_names.index("mass_factor")]
    assert len(set(factor)) == 3
    assert ((factor >= 0.7) & (factor <= 1.3)).all()
    assert read_walk(task, data, rows[0])[0].body.mass == factor[rows[0]] * task.body.mass
    share = data.parameters[:, data.frame.parameter_names.index("speed_factor")]
    assert len(set(share)) == 3
    assert ((share >= 0.3) & (share <= 1.0)).all()
    own = read_walk(task, data, rows[0])[0]
    assert np.allclose(own.reference.velocity, share[rows[0]] * task.reference.velocity)
    assert all(check.passed for check in verify(path).checks if check.name.startswith("rows."))
    # Such walks serve the controller of flat ground, which finds footholds by itself.
    library = read_dataset_library(path, compute_library_key(task), compute_library_key)
    assert library.walks == len(rows)


def test_sections_have_heights_above_their_own_ground() -> None:
    task = build_task(SPEC.walk, load_body("scaler"))
    world = np.concatenate(
        [[1.0, 1.0], *2 * [[0.25, 0.5, 0.75, 1.0]], np.full(2 * NUM_TREADS, 0.04)]
    )
    raised = apply_world(task, world)
    state = np.tile(task.start.state, (task.knots + 1, 1))
    state[:, 0] = 0.6  # all feet on treads of the same height
    flat = cut_sections(task, _standing(state), 0)
    state[:, 2] += 0.04
    above = cut_sections(raised, _standing(state), 0)
    assert np.allclose(above.features, flat.features)
    assert np.allclose(above.state, flat.state)


def test_sections_of_another_speed_are_farther_away() -> None:
    task = build_task(SPEC.walk, load_body("scaler"))
    state = np.tile(task.start.state, (task.knots + 1, 1))
    near, far = (
        cut_sections(apply_world(task, np.concatenate([[1.0, share], FLAT])), _standing(state), 0)
        for share in (0.5, 0.25)
    )
    apart = (near.features - far.features)[0]
    asked = 0.25 * np.linalg.norm(task.reference.velocity[0])
    assert np.linalg.norm(apart) == pytest.approx(asked / 0.4)
    assert len(near.features[0]) == feature_count(task.body.leg_count)


def _standing(state: np.ndarray) -> WalkTrajectory:
    knots = len(state)
    toes = np.zeros((knots, 4, 3))
    gait = Gait(np.ones((knots, 4), bool), np.zeros((knots, 4), np.int64))
    return WalkTrajectory(state, toes, toes, gait)


def test_a_flat_world_leaves_ground_and_toes_as_they_are() -> None:
    task = build_task(SPEC.walk, load_body("scaler"))
    world = np.concatenate([[1.2, 1.0], FLAT])
    same = apply_world(task, world)
    assert same.ground is task.ground
    assert same.body.mass == pytest.approx(1.2 * task.body.mass)
    assert np.array_equal(same.start.toes, task.start.toes)
    with pytest.raises(ValidationError, match="the shorter first"):
        WorldRangesSpec(tread=(0.5, 0.2))
    with pytest.raises(ValidationError, match="the lesser first"):
        WorldRangesSpec(speed=(0.5, 0.2))
