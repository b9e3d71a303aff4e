"""Motions as rows: scenes are drawn alike, files are kept with rows, damage to them is noticed."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes import SharedFolders
from toy_rows import FRAME

import climbplan
from climbplan.cli.app import run
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.datasets.motions.motion_trial import time_by_dynamics
from climbplan.datasets.motions.scenes import (
    NO_ROBOT,
    SceneFamilies,
    SceneSample,
    list_meshes,
    make_course,
    measure_height,
)
from climbplan.datasets.motions.statistics import count_motions
from climbplan.datasets.motions.walkers import prepare_walkers
from climbplan.datasets.schema.loading import load_dataset
from climbplan.datasets.schema.motions import MotionsProblemSpec, SpecSceneSpec
from climbplan.datasets.shards import ShardStore
from climbplan.errors import SpecError, UsageError
from climbplan.motions.measure import measure_motion
from climbplan.motions.motion_file import read_motion_file
from climbplan.scan.courses import make_slope
from climbplan.schema.loaded import LoadedSpec
from climbplan.store.dataset import Dataset, DatasetFrame, build_solution_layout
from climbplan.store.dataset_file import read_dataset_file, write_dataset_file
from climbplan.store.dataset_row import Row, RowAnswer, build_dataset, derive_seed

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "specs" / "dataset_motions.yaml"
FILES = DatasetFrame(
    "toy",
    "toy",
    {},
    ("a", "b"),
    (),
    {
        "usable": build_solution_layout((), kind="bool"),
        "motion": build_solution_layout((), "path", kind="text"),
    },
)


def families(**changes: object) -> SceneFamilies:
    loaded = load_dataset(SHIPPED)
    problem = loaded.spec.problem
    assert isinstance(problem, MotionsProblemSpec)
    problem = MotionsProblemSpec.model_validate({**problem.model_dump(), **changes})
    walkers = prepare_walkers(problem.robots, loaded.directory)
    return SceneFamilies(problem.scenes, walkers, loaded.directory, 60.0)


def test_a_row_is_drawn_from_its_seed_within_the_ranges() -> None:
    whole = families()
    drawn = [whole.draw(np.random.default_rng(derive_seed(1, k))) for k in range(40)]
    assert drawn[5] == whole.draw(np.random.default_rng(derive_seed(1, 5)))
    assert len({scene.name for scene in drawn}) == 40
    assert {scene.scene for scene in drawn} == {0, 1, 2, 3}
    for scene in drawn:
        numbers = dict(zip(whole.parameter_names, whole.encode(scene), strict=True))
        label = whole.labels[scene.scene]
        others = [name for name in numbers if "." in name and not name.startswith(f"{label}.")]
        assert all(numbers[name] == 0 for name in others)
        assert scene.robot == (NO_ROBOT if label == "climb_walker" else 0)
        if label == "stairs":
            assert 0.05 <= numbers["stairs.rise"] <= 0.12
            assert numbers["stairs.steps"] in (2, 3)


def test_grounds_begin_level_and_end_where_the_way_does() -> None:
    scenes = [{"family": family} for family in ("stairs", "steps", "slope", "stones", "rubble")]
    whole = families(scenes=scenes)
    for k in range(12):
        drawn = whole.draw(np.random.default_rng(k))
        scene = whole.scenes[drawn.scene]
        assert not isinstance(scene, SpecSceneSpec)
        course = make_course(scene, drawn.values, drawn.seed)
        again = make_course(scene, drawn.values, drawn.seed)
        np.testing.assert_array_equal(course.mesh.vertices, again.mesh.vertices)
        assert course.mesh.volume > 0
        corners = course.mesh.triangles
        assert measure_height(corners, 0.01) == pytest.approx(0.0)
        assert measure_height(corners, course.length - 0.01) == pytest.approx(course.rise, abs=0.08)


def test_specs_are_those_of_robot_and_ground(tmp_path: Path) -> None:
    whole = families()
    drawn = SceneSample(
        "silvia_slope_0", 1, 0, {"friction": 0.8, "angle_deg": 10, "length": 0.7}, 3
    )
    spec = yaml.safe_load(whole.load(drawn, tmp_path).text)
    assert spec["terrain"]["friction"] == 0.8
    rise = 0.7 * np.tan(np.deg2rad(10))
    assert spec["task"]["goal"]["com"][2] == pytest.approx(rise + 0.24, abs=1e-4)
    assert spec["task"]["start"]["com"][1] + 0.445 == pytest.approx(0.2)  # foremost toes
    walls = SceneSample("walker_0", 3, NO_ROBOT, {"terrain.friction": 1.1}, 3)
    assert yaml.safe_load(whole.load(walls, tmp_path).text)["terrain"]["friction"] == 1.1


def test_dynamics_time_climbs_and_leave_walks() -> None:
    climb = climbplan.load_spec(ROOT / "specs" / "climb_walker.yaml")
    assert isinstance(climb, LoadedClimb)
    timed = time_by_dynamics(climb)
    assert isinstance(timed, LoadedClimb)
    assert climb.spec.trajectory.pace is None
    assert timed.spec.trajectory.pace == "fastest"
    walk = climbplan.load_spec(ROOT / "specs" / "mpc_forward.yaml")
    assert isinstance(walk, LoadedSpec)
    assert time_by_dynamics(walk) is walk


def test_scans_are_walked_over_at_their_own_heights(tmp_path: Path) -> None:
    scans = tmp_path / "scans"
    scans.mkdir()
    with pytest.raises(UsageError, match="no mesh in it"):
        list_meshes(scans)
    make_slope(0.2, 0.5).write(scans / "slope.stl")
    whole = families(scenes=[{"family": "scans", "folder": str(scans), "length": [2.0, 2.0]}])
    drawn = whole.draw(np.random.default_rng(0))
    spec = yaml.safe_load(whole.load(drawn, tmp_path).text)
    assert spec["terrain"]["scan"]["file"] == str(scans / "slope.stl")
    start, goal = (spec["task"][name]["com"] for name in ("start", "goal"))
    assert goal[1] - start[1] == pytest.approx(2.0)
    assert start[2] == pytest.approx(0.24)
    assert goal[2] == pytest.approx(0.24 + 0.5 * np.tan(0.2), abs=1e-3)
    with pytest.raises(UsageError, match="no ground at"):
        measure_height(make_slope(0.2, 0.5).mesh.triangles, 50.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("problem.robots.0.file=silvie", "expected a built-in robot.*did you mean 'silvia'"),
        ("problem.robots.0.file=no.urdf", "no such file 'no.urdf'"),
        ("problem.scenes.3.file=no.yaml", "problem.scenes.3.file: no such file"),
        ("problem.scenes.0.rise=[0.2, 0.1]", "expected the smaller number first"),
        ("problem.scenes.0.rise=[0.1, 0.9]", "expected numbers from 0 to 0.5"),
        ("problem.scenes.1={family: scans, folder: nowhere}", "no such folder 'nowhere'"),
        ("problem.robots=[]", "problem.robots: expected a robot for the scenes of `stairs`"),
    ],
)
def test_mistakes_are_found_before_anything_is_planned(change: str, message: str) -> None:
    with pytest.raises(SpecError, match=message):
        load_dataset(SHIPPED, [change])


def test_a_range_of_no_key_is_found_before_anything_is_planned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    change = "problem.scenes.3.ranges={terrain.fraction: [0.1, 0.2]}"
    assert run(["gen-data", str(SHIPPED), "--set", change, "-o", str(tmp_path / "out")]) == 2
    assert "terrain.fraction" in capsys.readouterr().err


def _make_row(index: int, path: str) -> Row:
    solution = {"usable": np.asarray(True), "motion": np.asarray(path)}
    answer = RowAnswer(
        "feasible",
        solution=solution,
        integers=np.zeros(0, np.int64),
        objective=1.0,
        files={path: b"motion"},
    )
    return Row(index, index, np.array([float(index), 0.5]), answer)


def test_files_are_kept_with_their_rows(tmp_path: Path) -> None:
    rows = ShardStore(tmp_path, FILES, "this run", 3, 2)
    with pytest.raises(UsageError, match="no rows in it"):
        rows.read_rows()
    rows.add([_make_row(0, "motions/a.npz"), _make_row(2, "motions/c.npz")])
    assert (tmp_path / "motions" / "a.npz").read_bytes() == b"motion"
    again = ShardStore(tmp_path, FILES, "this run", 3, 2)
    assert again.find().rows == {0, 2}
    assert again.read_rows().row.tolist() == [0, 2]
    again.add([Row(1, 1, np.array([1.0, 0.5]), RowAnswer("limit", "no plan"))])
    data = again.dataset()
    assert data.solution["motion"].tolist() == ["motions/a.npz", "", "motions/c.npz"]
    assert data.solution["usable"].tolist() == [True, False, True]


def test_texts_are_read_as_written_and_paths_follow_the_file(tmp_path: Path) -> None:
    data = build_dataset(
        FILES, [_make_row(0, "motions/a.npz"), Row(1, 1, None, RowAnswer("limit"))]
    )
    data = replace(data, spec_sha256="0" * 64)
    elsewhere = tmp_path / "parts"
    elsewhere.mkdir()
    moved = data.move(tmp_path, elsewhere)
    write_dataset_file(moved, elsewhere / "train.h5")
    found = read_dataset_file(elsewhere / "train.h5")
    assert found.solution["motion"].tolist() == ["../motions/a.npz", ""]
    assert found.frame == data.frame
    assert found.move(elsewhere, tmp_path).solution["motion"].tolist() == ["motions/a.npz", ""]


def test_numbers_of_other_kinds_are_as_they_were() -> None:
    data = build_dataset(FRAME, [Row(0, 0, np.zeros(2), RowAnswer("limit"))])
    assert np.isnan(data.solution["x"]).all()


SPEC = """\
kind: dataset
count: 3
seed: 3
problem:
  kind: motions
  pace: fastest
  scenes:
    - {family: spec, file: chimney.yaml, ranges: {terrain.friction: [0.9, 1.1]}}
    - {family: spec, file: steep.yaml, ranges: {terrain.friction: [0.9, 1.1]}}
"""


@pytest.fixture(scope="session")
def generated(shared_folders: SharedFolders) -> Path:
    """A dataset of a quadruped between parallel and inclined walls, some of which are too steep."""
    for library in ("mujoco", "pinocchio"):
        pytest.importorskip(library)
    return shared_folders.make("motions", _generate)


def _generate(folder: Path) -> None:
    (folder / "motions.yaml").write_text(SPEC)
    spec = yaml.safe_load((ROOT / "specs" / "climb_walker.yaml").read_text())
    spec["robot"] = str(ROOT / "specs" / "robot_walker.yaml")
    spec["task"] |= {"rounds": 1, "goal": {"com": [0, 0, 0.12]}}
    (folder / "chimney.yaml").write_text(yaml.safe_dump(spec))
    spec["terrain"]["walls"]["gap"] = 2.5  # out of reach
    (folder / "steep.yaml").write_text(yaml.safe_dump(spec))
    assert run(["gen-data", str(folder / "motions.yaml"), "-o", str(folder / "one")]) == 0


def _read(folder: Path) -> Dataset:
    return read_dataset_file(folder / "dataset.h5")


@pytest.mark.slow
def test_motions_are_usable_where_they_are_planned_and_stand(generated: Path) -> None:
    data = _read(generated / "one")
    usable = data.solution["usable"]
    scene = data.parameters[:, data.frame.parameter_names.index("scene")]
    assert data.verified
    np.testing.assert_array_equal(usable, scene == 0)
    assert usable.any()
    assert not usable.all()
    assert (data.solution["pace"][usable] > 1).all()
    for row in range(data.count):
        path, digest = data.solution["motion"][row], data.solution["sha256"][row]
        if not usable[row]:
            assert data.message[row]
            assert path == digest == ""
            continue
        content = (generated / "one" / path).read_bytes()
        assert hashlib.sha256(content).hexdigest() == digest
        motion = read_motion_file(generated / "one" / path)
        assert motion.is_verified
        residual = {check.name: check.residual for check in measure_motion(motion, {})}
        assert residual["contact.slip"] < 1e-3
        assert residual["contact.penetration"] < 2e-3
    assert sum(count.usable for count in count_motions(data)) == usable.sum()


@pytest.mark.slow
def test_rows_are_the_same_with_two_workers(generated: Path, tmp_path: Path) -> None:
    two = tmp_path / "two"
    assert run(["gen-data", str(generated / "motions.yaml"), "-o", str(two), "--jobs", "2"]) == 0
    first, second = _read(generated / "one"), _read(two)
    np.testing.assert_array_equal(first.parameters, second.parameters)
    for name in ("usable", "motion", "sha256", "terrain", "terrain_sha256", "samples"):
        np.testing.assert_array_equal(first.solution[name], second.solution[name])
    assert first.status == second.status
    assert first.message == second.message


@pytest.mark.slow
def test_verification_notices_changed_motions_and_follows_parts(
    generated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(generated / "one", copy)
    dataset = copy / "dataset.h5"
    parts = tmp_path / "parts"
    assert run(["data", "split", str(dataset), "--test", "0.4", "--files", str(parts)]) == 0
    assert run(["verify", str(parts / "train.h5")]) == 0
    whole = tmp_path / "whole.h5"
    assert run(["data", "merge", *map(str, parts.glob("*.h5")), "-o", str(whole)]) == 0
    assert run(["verify", str(whole)]) == 0
    capsys.readouterr()
    assert run(["data", "info", str(whole), "--json"]) == 0
    (info,) = json.loads(capsys.readouterr().out)["datasets"]
    assert [entry["usable"] for entry in info["motions"]] == [
        entry["rows"] if entry["scene"] == "chimney" else 0 for entry in info["motions"]
    ]
    motion = next((copy / "motions").glob("*.npz"))
    content = motion.read_bytes()
    motion.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert run(["verify", str(whole)]) == 5
    assert "rows.files" in capsys.readouterr().out
