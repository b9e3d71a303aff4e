"""Walks on scanned terrain: regions near the path, swings above it, checks by its triangles."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.errors import SpecError
from climbplan.terrain.raw_surface import RawSurface
from climbplan.walking.check.checker import check_trajectory
from climbplan.walking.check.plan_checks import check_plan
from climbplan.walking.check.scan import compute_depth
from climbplan.walking.kernels.swept_terrain import find_highest_cell
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.problem.problem import build_task
from climbplan.walking.problem.scanning import build_path, fit_walk_scan, load_walk_surface
from climbplan.walking.schema.loading import LoadedMpc, load_mpc
from climbplan.walking.task.height_grid import build_height_grid, find_highest_near

FLOOR = ((-0.8, -1.0, -0.1), (0.8, 0.32, 0.0))
STEP = ((-0.8, 0.32, -0.1), (0.8, 0.62, 0.03))
LANDING = ((-0.8, 0.62, -0.1), (0.8, 3.0, 0.06))
FAR_AWAY = ((-0.5, 8.0, 0.0), (0.5, 9.0, 0.1))
RIB = ((-0.8, 0.45, 0.03), (0.8, 0.455, 0.05))  # too thin to stand on
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
_FACES = [
    (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
    (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5),
]  # fmt: skip
SPEC = """\
kind: mpc
forward: y
terrain:
  friction: 0.9
  scan: {file: steps.stl}
task:
  knots: 9
  start: {position: [0, 0.1], velocity: [0, 0.5, 0]}
  reference: {velocity: [0, 0.6, 0]}
  min_contacts: 2
solver: {max_qp_solves: 60}
"""


# Lowest and highest corner (3,) of a box [m]
Box = tuple[tuple[float, ...], tuple[float, ...]]


def write_mesh(path: Path, *boxes: Box) -> None:
    lines = ["solid steps"]
    for low, high in boxes:
        corners = np.array(low) + _CORNERS * (np.array(high) - np.array(low))
        for face in _FACES:
            points = [f"vertex {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners[list(face)]]
            lines += ["facet normal 0 0 0", "outer loop", *points, "endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid steps", ""]))


def loaded(folder: Path, text: str = SPEC, extra: tuple[Box, ...] = ()) -> LoadedMpc:
    write_mesh(folder / "steps.stl", FLOOR, STEP, LANDING, FAR_AWAY, *extra)
    (folder / "walk.yaml").write_text(text)
    return load_mpc(folder / "walk.yaml")


@cache
def walked() -> WalkPlan:
    return plan_walk(loaded(Path(mkdtemp())))


def surface(*boxes: tuple[tuple[float, ...], tuple[float, ...]]) -> RawSurface:
    corners = [np.array(a) + _CORNERS * (np.array(b) - np.array(a)) for a, b in boxes]
    triangles = np.concatenate([np.array(_FACES) + 8 * k for k in range(len(boxes))])
    return RawSurface(np.concatenate(corners), triangles, 0.005, 0.01)


def test_a_scanned_stair_is_walked_up_and_verified(tmp_path: Path) -> None:
    plan = walked()
    write_walk_plan(plan, tmp_path / "plan.h5")
    stored = read_walk_plan(tmp_path / "plan.h5")
    checks = {check.name: check for check in check_plan(stored)}
    assert [name for name, check in checks.items() if not check.passed] == []
    assert {"scan.toes", "scan.swing", "contact.region"} <= set(checks)
    stood = stored.task.ground.height[stored.trajectory.gait.region[stored.trajectory.gait.contact]]
    assert set(np.round(stood, 6)) >= {0.0, 0.03}
    assert stored.task.ground.scan is not None
    assert plan.task.ground.scan is not None
    np.testing.assert_array_equal(stored.task.ground.scan.vertices, plan.task.ground.scan.vertices)
    assert "fit: false" in stored.spec_text  # the plan does not depend on the file


def test_changes_of_a_plan_are_found_by_the_triangles() -> None:
    plan = walked()
    task, trajectory = plan.task, plan.trajectory
    swings = np.argwhere(~trajectory.gait.contact[1:-1]) + np.array([1, 0])

    def failures(toes: Array) -> set[str]:
        changed = replace(trajectory, toes=toes)
        return {check.name for check in check_trajectory(task, changed) if not check.passed}

    assert "scan.swing" not in failures(trajectory.toes)
    toes = trajectory.toes.copy()
    toes[tuple(swings[0])][2] -= 0.035
    assert "scan.swing" in failures(toes)
    toes = trajectory.toes.copy()
    toes[:, :, 2] -= 0.008
    assert "scan.toes" in failures(toes)


def test_regions_near_the_path_enter_the_problem(tmp_path: Path) -> None:
    walk = loaded(tmp_path)
    np.testing.assert_allclose(build_path(walk.spec), [[0, 0.1], [0, 0.1 + 9 * 0.08 * 0.6]])
    fitted = fit_walk_scan(walk)
    assert fitted.spec.terrain.scan is not None
    assert not fitted.spec.terrain.scan.fit
    heights = sorted(region.plane.point[2] for region in fitted.spec.terrain.regions)
    np.testing.assert_allclose(heights, [0.0, 0.03, 0.06], atol=1e-9)  # none far away
    assert fit_walk_scan(fitted) is fitted
    raw = load_walk_surface(fitted)
    assert raw is not None
    assert raw.vertices[:, 1].max() <= 3.0
    task = build_task(fitted.spec, fitted.robot, scan=raw)
    assert task.ground.edge == 0.0
    assert task.ground.corners.shape[1] == 0  # rectangles along the axes


def test_swings_clear_what_has_no_region(tmp_path: Path) -> None:
    walk = fit_walk_scan(loaded(tmp_path, extra=(RIB,)))
    raw = load_walk_surface(walk)
    assert raw is not None
    grid = build_height_grid(raw)
    start, end = np.array([0.0, 0.40]), np.array([0.0, 0.50])
    assert find_highest_cell(start, end, grid) == pytest.approx(0.05)
    assert find_highest_cell(start, np.array([0.0, 0.41]), grid) == pytest.approx(0.03)


def test_cells_bound_the_surface() -> None:
    rng = np.random.default_rng(0)
    scan = surface(FLOOR, STEP, RIB)
    turned = np.array([[1, 0, 0], [0, 0.95, -0.31], [0, 0.31, 0.95]])
    scan = replace(scan, vertices=scan.vertices @ turned.T)
    points = np.column_stack([rng.uniform([-0.7, -0.8], [0.7, 0.5], (300, 2)), np.full(300, -5.0)])
    heights = compute_depth(points, scan) - 5.0
    grid = build_height_grid(scan)
    bound = find_highest_near(grid, points[:, :2], 0.0)
    assert (bound >= heights - 1e-9).all()
    assert np.median(bound - heights) < 0.02
    outside = find_highest_near(grid, np.array([[50.0, 0.0]]), 0.01)
    assert outside[0] < -1e20


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("steps.stl", "no.stl"), "no.stl"),
        (("position: [0, 0.1]", "position: [0, 50]"), "does not come near the path"),
        (("steps.stl}", "steps.stl, min_size: 9}"), "no foothold region"),
    ],
)
def test_scans_that_do_not_serve_name_line_and_key(
    tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    walk = loaded(tmp_path, SPEC.replace(*change))
    with pytest.raises(SpecError) as caught:
        fit_walk_scan(walk)
    said = str(caught.value)
    assert ":5: terrain.scan.file" in said
    assert words in said
