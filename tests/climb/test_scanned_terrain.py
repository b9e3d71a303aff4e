"""From a mesh to a verified climb, and what its checks do not let pass."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from known_surfaces import box, joined

import climbplan
from benchmarks.climb.rocky_tubes import rocky_tube
from benchmarks.climb.windows import TUBE
from climbplan.climb.check.scan import check_scan
from climbplan.climb.check.subject import build_subject
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.errors import SpecError
from climbplan.robots.foot import Foot
from climbplan.verification.check import SCAN_LIMITS

SPEC = """\
kind: climb
robot: silvia
terrain:
  friction: 0.8
  scan: {{file: {file}, steepest_deg: 40}}
task:
  rounds: 2
  start: {{com: [0, 0, 0.24]}}
  goal: {{com: [0, 0.15, 0.26]}}
solver: {{method: micp}}
"""


def brick_mesh(folder: Path) -> Path:
    """A floor with a low brick on it, whose triangles do not know of each other."""
    raw = joined(box((-1.2, -1.2, -0.1), (1.2, 1.2, 0)), box((-0.3, 0.45, -0.05), (0.3, 0.8, 0.04)))
    path = folder / "brick.stl"
    trimesh.Trimesh(raw.vertices, raw.triangles, process=False).export(path)
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ClimbPlan]:
    folder = tmp_path_factory.mktemp("scan")
    brick_mesh(folder)
    spec = folder / "spec.yaml"
    spec.write_text(SPEC.format(file="brick.stl"))
    plan = climbplan.plan(spec)
    path = folder / "plan.h5"
    plan.save(path)
    return path, read_climb(path)


def outcome(plan: ClimbPlan) -> dict[str, bool]:
    return {c.name: c.passed for c in verify_plan(plan).checks if c.name in SCAN_LIMITS}


def test_a_mesh_is_climbed_and_the_plan_needs_it_no_more(made, tmp_path: Path) -> None:
    path, plan = made
    (path.parent / "brick.stl").rename(tmp_path / "away.stl")
    try:
        verification = climbplan.verify(path)
    finally:
        (tmp_path / "away.stl").rename(path.parent / "brick.stl")
    assert verification.passed
    assert outcome(plan) == dict.fromkeys(SCAN_LIMITS.keys() - {"scan.grips"}, True)
    assert plan.terrain.scan is not None
    assert 12 < len(plan.terrain.scan.triangles) <= 24  # those within reach


def test_the_plan_answers_its_users_spec_fitted_anew(made) -> None:
    path, _ = made
    assert climbplan.verify(path, path.parent / "spec.yaml").passed


def test_another_mesh_under_the_same_name_is_seen(made, tmp_path: Path) -> None:
    path, _ = made
    brick_mesh(tmp_path)
    moved = trimesh.load_mesh(tmp_path / "brick.stl")
    moved.apply_translation([0, 0, 0.003])
    moved.export(tmp_path / "brick.stl")
    (tmp_path / "spec.yaml").write_text(SPEC.format(file="brick.stl"))
    assert not climbplan.verify(path, tmp_path / "spec.yaml").passed


def moved(plan: ClimbPlan, by: tuple[float, float, float]) -> ClimbPlan:
    scan = plan.terrain.scan
    assert scan is not None
    other = replace(scan, vertices=scan.vertices + np.array(by))
    return replace(plan, terrain=replace(plan.terrain, scan=other))


def test_a_surface_lower_than_the_flatness_fails_the_toes(made) -> None:
    assert outcome(moved(made[1], (0, 0, -0.004)))["scan.toes"]
    assert not outcome(moved(made[1], (0, 0, -0.006)))["scan.toes"]


def test_a_spherical_foot_that_reaches_into_the_surface_fails_the_toes(made) -> None:
    """Toes of this plan are on the surface: a sphere about them is as deep as its radius."""
    for radius, passes in ((0.004, True), (0.006, False)):
        plan = made[1]
        subject = build_subject(replace(plan, robot=replace(plan.robot, foot=Foot(radius))))
        checks = {check.name: check.passed for check in check_scan(subject, plan.terrain.scan)}
        assert checks["scan.toes"] is passes


def test_a_surface_that_rises_fails_limbs_and_body(made) -> None:
    higher = outcome(moved(made[1], (0, 0, 0.12)))
    assert not higher["scan.limbs"]
    assert not higher["scan.trajectory"]
    assert not outcome(moved(made[1], (0, 0, 0.2)))["scan.body"]


def test_a_slippery_slope_under_a_toe_fails_friction(made) -> None:
    plan = made[1]
    scan = plan.terrain.scan
    assert scan is not None
    turn = np.deg2rad(45.0)
    tilted = scan.corners
    loaded = np.linalg.norm(plan.forces.force[0], axis=1)
    toe = plan.instants.toes[0, int(np.argmax(loaded))]
    # A small tilted plate through one toe, in place of all else near it
    size = 0.05
    slope = np.array([[-size, -size, 0], [size, -size, 0], [size, size, 0], [-size, size, 0]])
    slope[:, 2] = -np.sign(toe[0]) * np.tan(turn) * slope[:, 0]  # downhill, away from the body
    vertices = np.concatenate([tilted.reshape(-1, 3), toe + slope])
    count = 3 * len(tilted)
    triangles = count + np.array([[0, 1, 2], [0, 2, 3]])
    other = replace(scan, vertices=vertices, triangles=triangles)
    told = outcome(replace(plan, terrain=replace(plan.terrain, scan=other)))
    assert not told["scan.friction"]


def test_a_scan_out_of_reach_says_how_far_it_is(tmp_path: Path) -> None:
    brick_mesh(tmp_path)
    spec = tmp_path / "spec.yaml"
    text = SPEC.format(file="brick.stl").replace("[0, 0, 0.24]", "[0, 0, 5]")
    spec.write_text(text.replace("[0, 0.15, 0.26]", "[0, 0, 5.2]"))
    with pytest.raises(SpecError, match=r"spec.yaml:5: terrain.scan.file: .*reaches"):
        climbplan.plan(spec)


def test_a_way_through_the_ground_is_refused(tmp_path: Path) -> None:
    brick_mesh(tmp_path)
    spec = tmp_path / "spec.yaml"
    spec.write_text(SPEC.format(file="brick.stl").replace("[0, 0.15, 0.26]", "[0, 0.4, 0.05]"))
    with pytest.raises(SpecError, match="the body's way from start to goal meets the scan near"):
        climbplan.plan(spec)


def test_a_broken_scan_ends_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "brick.stl").write_text("no mesh")
    spec = tmp_path / "spec.yaml"
    spec.write_text(SPEC.format(file="brick.stl"))
    with pytest.raises(SpecError, match=r"spec.yaml:5: terrain.scan.file: .*brick.stl"):
        climbplan.plan(spec)


def shared_mesh(name: str) -> Path:
    """One of the meshes beside the project, whose licence is there; else the test is skipped."""
    folder = Path(os.environ.get("CLIMBPLAN_TERRAIN", "../shared/data/terrain"))
    path = folder / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path.resolve()


def test_the_simulated_toes_stand_on_raw_triangles(made) -> None:
    pytest.importorskip("mujoco", reason="mujoco is missing: pip install '.[simulate]'")
    from climbplan.climb.simulation.model.terrain_geoms import build_scan_geoms
    from climbplan.climb.simulation.model.toe import TOE_RADIUS
    from climbplan.simulation.conditions import Conditions

    plan, assets = made[1], []
    scan = plan.terrain.scan
    assert scan is not None
    geoms = build_scan_geoms(scan, plan.rounds.toes, 0.5, assets, TOE_RADIUS)
    assert len(geoms) == len(assets) >= 4
    assert Conditions().friction == 1.0
    first = assets[0].split('vertex="')[1].split('"')[0]
    prism = np.array(first.split(), float).reshape(6, 3)
    np.testing.assert_allclose(prism[:3].mean(axis=0), 0, atol=1e-9)
    assert TOE_RADIUS < 1e-3
    # The replay of the whole plan on them
    found = climbplan.load_plan(made[0]).simulate()
    assert found is not None


WALKS = {
    "stairs": ("-0.45, 0.8, 0.28", "0.45, 0.8, 0.47", 18, 10, "micp"),
    "bauzil_stairs_clean": ("-0.55, 1.0, 0.28", "0.35, 1.0, 0.46", 18, 10, "micp"),
    "slope_towr": ("0.1, 0, 0.28", "0.95, 0, 0.36", 8, 9, "micp"),
    # Its steps end in edges that tibias pass closely: found with exact rotations, after micp
    "rubbles_stairs_1": ("4.5, 0, 0.28", "5.4, 0, 0.47", 18, 8, "auto"),
    "slalom_debris": ("-1.2, 0.2, 0.28", "-0.6, 0.55, 0.28", 0, 8, "auto"),  # up to its debris
}
WALK = """\
kind: climb
robot: silvia
terrain:
  friction: 0.8
  scan: {{file: {file}, steepest_deg: 40}}
task:
  rounds: {rounds}
  start: {{com: [{start}], rpy_deg: [0, 0, -90]}}
  goal: {{com: [{goal}], rpy_deg: [{pitch}, 0, -90]}}
  stance: {{RF: [0.25, 0.42, -0.28], RM: [0.44, 0, -0.28], RR: [0.25, -0.42, -0.28],
    LR: [-0.25, -0.42, -0.28], LM: [-0.44, 0, -0.28], LF: [-0.25, 0.42, -0.28]}}
trajectory: {{swing_clearance: 0.06}}
solver: {{method: {method}}}
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", WALKS)
def test_meshes_of_another_project_are_walked(tmp_path: Path, name: str) -> None:
    start, goal, pitch, rounds, method = WALKS[name]
    spec = tmp_path / f"{name}.yaml"
    file = shared_mesh(f"{name}.stl")
    text = WALK.format(file=file, start=start, goal=goal, pitch=pitch, rounds=rounds, method=method)
    spec.write_text(text)
    assert len(spec.read_text().splitlines()) <= 15
    plan = climbplan.plan(spec)
    assert plan.verify().passed


@pytest.mark.slow
def test_rubble_and_the_stairs_behind_it_are_walked(tmp_path: Path) -> None:
    file = shared_mesh("rubbles_stairs_1.stl")
    spec = tmp_path / "rubbles.yaml"
    goal = "6.9, 0, 0.89"
    given = {"file": f"{file}, guide: [[4.5, 0, 0.28]]", "start": "0.2, 0, 0.28", "goal": goal}
    text = WALK.format(**given, pitch=18, rounds="auto", method="auto, time_limit: 600")
    spec.write_text(text)
    assert len(spec.read_text().splitlines()) <= 15
    plan = climbplan.plan(spec)
    assert plan.verify().passed
    assert len(plan.rounds.com) > 40
    assert plan.sizes["posture"]["moves_checked"] > 240


@pytest.mark.slow
def test_a_rocky_tube_of_a_thousand_panels_is_climbed(tmp_path: Path) -> None:
    tube = rocky_tube()
    assert len(tube.faces) == 1000
    tube.export(tmp_path / "tube.stl")
    spec = tmp_path / "tube.yaml"
    spec.write_text(TUBE.format(goal=0.7))
    plan = climbplan.plan(spec)
    assert plan.verify().passed
    assert len(plan.rounds.com) - 1 >= 4
    assert plan.sizes["posture"]["windows"] >= 2
