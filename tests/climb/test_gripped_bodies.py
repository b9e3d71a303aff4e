"""Cubes of a mesh, gripped by their sides: planned, checked on raw triangles, refused in words."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

import climbplan
from benchmarks.climb.scans import spec_of
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.scene.scanning import fit_scan
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.schema.examples import read_example

ROBOT = "robot_long_climber"
SIDE, RAIL, APART = 0.1, 0.25, 0.44  # [m] of cubes in two upright rows


def climb(folder: Path, **holds: Any) -> Path:
    """Two rows of cubes that face -y, and a climb from four of them by 0.1 m."""
    places = [(x, 0.0, z) for x in (-RAIL, RAIL) for z in APART * (np.arange(3) - 0.5)]
    boxes = [trimesh.creation.box((SIDE,) * 3).apply_translation(place) for place in places]
    trimesh.util.concatenate(boxes).export(folder / "cubes.stl")
    (folder / f"{ROBOT}.yaml").write_text(read_example(ROBOT))
    before = -(SIDE / 2 + 0.1 + 0.33)  # palm, wrist, stance
    spec = {
        "kind": "climb",
        "robot": f"{ROBOT}.yaml",
        "terrain": {"friction": 0.8, "scan": {"file": "cubes.stl", "holds": holds}},
        "task": {
            "rounds": 1,
            "start": {"com": [0, before, 0], "rpy_deg": [90, 0, 0]},
            "goal": {"com": [0, before, 0.1], "rpy_deg": [90, 0, 0], "tolerance": 0.02},
        },
        "posture": {"steps": {"com_max": 0.2, "toe_max": 0.6}},
        "solver": {"method": "micp", "time_limit": 300},
    }
    path = folder / "cubes.yaml"
    path.write_text(yaml.safe_dump(spec, sort_keys=False))
    return path


def test_holds_are_regions_and_the_raw_mesh_stays(tmp_path: Path) -> None:
    terrain = fit_scan(load_climb(climb(tmp_path))).spec.terrain
    assert terrain.panel is None
    assert terrain.gripped
    assert len({region.name for region in terrain.regions}) == len(terrain.regions) >= 12
    assert all(region.hold is not None for region in terrain.regions)
    assert terrain.free_regions


def test_what_fingers_do_not_open_to_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="open 110 mm, got an opening of 150 mm"):
        fit_scan(load_climb(climb(tmp_path, opening=0.15)))
    with pytest.raises(SpecError, match="no graspable spot on the closed bodies"):
        fit_scan(load_climb(climb(tmp_path, opening=0.09)))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    folder = tmp_path_factory.mktemp("cubes")
    plan = climbplan.plan(climb(folder))
    assert plan.verify().passed
    plan.save(folder / "plan.h5")
    return read_climb(folder / "plan.h5")


def gripped(plan: ClimbPlan) -> bool:
    return {c.name: c.passed for c in verify_plan(plan).checks}["scan.grips"]


@pytest.mark.slow
def test_sides_are_measured_on_the_raw_triangles(made: ClimbPlan) -> None:
    scan = made.terrain.scan
    assert scan is not None
    assert scan.finger_depth == 0.015
    assert gripped(made)

    def on(vertices: np.ndarray) -> ClimbPlan:
        raw = replace(scan, vertices=vertices)
        return replace(made, terrain=replace(made.terrain, scan=raw))

    # Cubes wider than fingers open; sides that lean back by 2 degrees; as before, moved by 1 mm
    half = np.array([0.5, 0.0, 0.5])
    middle = np.round(scan.vertices / [2 * RAIL, 1.0, APART] - half) + half
    middle = middle * [2 * RAIL, 0.0, APART]
    own = scan.vertices - middle
    assert np.abs(np.abs(own) - SIDE / 2).max() < 1e-5
    assert not gripped(on(middle + own * [1.3, 1.0, 1.3]))
    lean = 1 + (own[:, 1:2] + SIDE / 2) * np.tan(np.deg2rad(2.0)) / (SIDE / 2)
    assert not gripped(on(middle + own * np.hstack([lean, lean**0, lean])))
    assert gripped(on(scan.vertices + np.array([0.001, 0.0, 0.0])))


@pytest.mark.slow
def test_the_climbing_scene_of_another_project_is_climbed(tmp_path: Path) -> None:
    folder = Path(os.environ.get("CLIMBPLAN_TERRAIN", "../shared/data/terrain"))
    if not (folder / "climb.stl").exists():
        pytest.skip(f"{folder / 'climb.stl'} is not there")
    shutil.copy(folder / "climb.stl", tmp_path / "climb.stl")
    text = spec_of("climb", tmp_path)
    assert len(text.splitlines()) <= 15
    (tmp_path / "climb.yaml").write_text(text)
    (tmp_path / f"{ROBOT}.yaml").write_text(read_example(ROBOT))
    plan = climbplan.plan(tmp_path / "climb.yaml")
    assert plan.verify().passed
