"""Graspable spots of a scanned wall: made-up holds are found where they are, as they are."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from climbplan.reports.fits.holds_report import find_graspable, write_holds
from climbplan.scan.clouds import build_cloud
from climbplan.scan.holds import Grasping, Wall, find_wall_holds
from climbplan.scan.panel import build_panel
from climbplan.scan.raw import RawScan, ScanError
from climbplan.scan.reading import read_scan
from climbplan.scan.relief import triangulate_cloud
from climbplan.scan.study import build_scan_spec
from climbplan.schema.terrain.panel import PanelSpec
from climbplan.terrain.holds import panel_frame

GRASPING = Grasping(opening=0.06, depth=0.015)
TURN = np.deg2rad(30.0)  # of the wall about z
LEAN = np.deg2rad(10.0)  # of an upright wall, backwards
# Middle across and up, length and width, turn of the narrow side from up to across, lean of sides
HOLDS = [
    ((-0.12, 0.05), 0.09, 0.034, 0.0, 20.0),
    ((0.05, 0.08), 0.09, 0.030, 90.0, 30.0),
    ((0.10, -0.07), 0.09, 0.034, 45.0, 10.0),
]
TALL = 0.035  # [m]


def frame() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Across, up and normal of the made-up wall."""
    across = np.array([np.cos(TURN), np.sin(TURN), 0.0])
    level = np.array([np.sin(TURN), -np.cos(TURN), 0.0])  # faces -y before it is turned
    normal = np.cos(LEAN) * level + np.sin(LEAN) * np.array([0.0, 0.0, 1.0])
    return across, np.cross(normal, across), normal


def height(u: np.ndarray, v: np.ndarray, holds: list[tuple]) -> np.ndarray:
    """Ridges with sides that lean back, on a plane."""
    out = np.zeros(u.shape)
    for (a, b), length, width, turn, lean in holds:
        angle = np.deg2rad(turn)
        along = np.cos(angle) * (v - b) + np.sin(angle) * (u - a)  # across the ridge
        beside = -np.sin(angle) * (v - b) + np.cos(angle) * (u - a)
        slope = 1.0 / np.tan(np.deg2rad(lean))
        ridge = TALL + slope * (width / 2 - np.abs(along))
        end = TALL + slope * (length / 2 - np.abs(beside))
        out = np.maximum(out, np.minimum(np.minimum(ridge, end), TALL))
    return out


def scan_with(holds: list[tuple]) -> RawScan:
    """A made-up wall as a cloud, joined to a relief."""
    across, up, normal = frame()
    line = np.arange(-0.2, 0.2, 3.5e-3)
    u, v = (x.ravel() for x in np.meshgrid(line, line[abs(line) < 0.15], indexing="ij"))
    rng = np.random.default_rng(0)
    h = height(u, v, holds) + rng.normal(0.0, 2e-4, u.shape)
    points = np.array([1.0, 2.0, 0.5]) + np.stack([u, v, h], axis=1) @ np.stack(
        [across, up, normal]
    )
    normals = np.broadcast_to(normal, points.shape)
    return triangulate_cloud(build_cloud(points, normals), Path("wall.xyz"))


def wall_of(holds: list[tuple], grasping: Grasping = GRASPING) -> Wall:
    return find_wall_holds(scan_with(holds), grasping)


@pytest.fixture(scope="module")
def wall() -> Wall:
    return wall_of(HOLDS)


def places(wall: Wall) -> np.ndarray:
    """Of its holds, in the frame in which they were made."""
    across, up, _ = frame()
    world = [wall.center + h.at[0] * wall.across + h.at[1] * wall.up for h in wall.holds]
    return (np.array(world) - [1.0, 2.0, 0.5]) @ np.stack([across, up], axis=1)


def test_the_wall_is_found_as_it_stands(wall: Wall) -> None:
    assert wall.angle_deg == pytest.approx(90.0 - np.rad2deg(LEAN), abs=0.5)
    assert wall.turn_deg == pytest.approx(np.rad2deg(TURN), abs=0.5)


@pytest.mark.parametrize("number", range(len(HOLDS)))
def test_holds_are_found_with_axis_and_sides(wall: Wall, number: int) -> None:
    middle, _, width, turn, lean = HOLDS[number]
    away = np.linalg.norm(places(wall) - middle, axis=1)
    found = wall.holds[int(np.argmin(away))]
    assert away.min() < 0.045  # somewhere along the ridge
    apart = (found.axis_deg - turn + 90.0) % 180.0 - 90.0
    assert abs(apart) <= 15.0
    # At the depth of the fingers a side that leans back is further out
    wide = width + 2 * GRASPING.depth * np.tan(np.deg2rad(lean))
    assert found.width == pytest.approx(wide, abs=8e-3)
    assert found.undercut_deg == pytest.approx(-lean, abs=12.0)  # in cells of 2.5 mm
    assert found.rise == pytest.approx(TALL - GRASPING.depth, abs=4e-3)


def test_the_steepest_come_first_and_none_is_found_on_the_plane(wall: Wall) -> None:
    backs = [hold.undercut_deg for hold in wall.holds]
    assert (np.diff(backs) <= 0.1).all()
    middles = np.array([h[0] for h in HOLDS])
    for place in places(wall):
        assert np.linalg.norm(middles - place, axis=1).min() < 0.05


def test_what_a_gripper_cannot_open_to_is_refused_with_amounts() -> None:
    with pytest.raises(ScanError, match=r"35 mm at most, has no two sides within .* of 30 mm"):
        wall_of(HOLDS, Grasping(opening=0.03))
    with pytest.raises(ScanError, match="no graspable spot"):
        wall_of([])


def test_a_panel_of_a_spec_is_written(wall: Wall, tmp_path: Path) -> None:
    panel = PanelSpec.model_validate(build_panel(wall))
    assert len(panel.holds) == len(wall.holds)
    assert panel.angle_deg == pytest.approx(80.0, abs=0.5)
    across, up, normal = frame()
    stated = panel_frame(panel)
    assert np.allclose(stated.across, across, atol=0.01)
    assert np.allclose(stated.up, up, atol=0.01)
    assert np.allclose(stated.normal, normal, atol=0.01)


@pytest.mark.slow
def test_holds_of_a_scan_are_written(tmp_path: Path) -> None:
    raw, wall = scan_with(HOLDS), wall_of(HOLDS)
    write_holds(
        find_graspable(raw, build_scan_spec(Path("wall.xyz"), []), GRASPING, "wall"), tmp_path
    )
    report = json.loads((tmp_path / "report.json").read_text())
    assert len(report["holds"]) == len(wall.holds)
    assert "graspable spots within an opening of 60 mm" in (tmp_path / "terrain.yaml").read_text()


@pytest.mark.slow
def test_the_shared_cloud_has_ten_holds_for_a_gripper_that_opens_wide() -> None:
    folder = Path(os.environ.get("CLIMBPLAN_TERRAIN", "../shared/data/terrain"))
    file = folder / "vertical_bouldering_holds.pcd"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    raw = read_scan(build_scan_spec(file, []), Path())
    wall = find_wall_holds(raw, Grasping(0.07))
    assert len(wall.holds) == 10  # as many as are seen
    assert len(find_wall_holds(raw, Grasping(0.05)).holds) < 4  # they are wider than that
    assert wall.angle_deg == pytest.approx(75.6, abs=0.5)
