"""Holds found in `terrain.scan`: the wall becomes a panel, in one command, wherever it faces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import climbplan
from climbplan.climb.scene.scanning import fit_scan
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError

TURN = np.deg2rad(30.0)  # of the wall about z: it faces -y before it
TALL, LENGTH, WIDTH, LEAN = 0.035, 0.08, 0.034, 8.0  # [m, m, m, deg] of ridges
BEFORE = 0.3595  # [m] of the body before its grips
LEGS = (("RF", 1, 1), ("RH", 1, -1), ("LH", -1, -1), ("LF", -1, 1))


def cloud(folder: Path, ups: np.ndarray) -> Path:
    """A wall with two columns of ridges at heights (K,) [m], as points 3.5 mm apart."""
    u, v = np.meshgrid(
        np.arange(-0.3, 0.3, 3.5e-3),
        np.arange(ups[0] - 0.12, ups[-1] + 0.12, 3.5e-3),
        indexing="ij",
    )
    rise, slope = np.zeros(u.shape), 1.0 / np.tan(np.deg2rad(LEAN))
    for a in (-0.18, 0.18):
        for b in ups:
            edge = np.minimum(WIDTH / 2 - np.abs(v - b), LENGTH / 2 - np.abs(u - a))
            rise = np.maximum(rise, np.minimum(TALL + slope * edge, TALL))
    rng = np.random.default_rng(0)
    rise = rise + rng.normal(0.0, 2e-4, u.shape)
    points = u[..., None] * ACROSS + v[..., None] * np.array([0.0, 0.0, 1.0])
    points = points + rise[..., None] * NORMAL
    path = folder / "wall.npy"
    np.save(path, points.reshape(-1, 3))
    return path


ACROSS = np.array([np.cos(TURN), np.sin(TURN), 0.0])
NORMAL = np.array([np.sin(TURN), -np.cos(TURN), 0.0])


def climb(folder: Path, ups: np.ndarray, **scan: Any) -> Path:
    """A climb of a quadruped with grippers by what is found in such a cloud."""
    file = cloud(folder, ups).name
    depth = TALL - 0.015
    start = (BEFORE + depth) * NORMAL
    rpy = [90, 0, float(np.rad2deg(TURN))]
    spec = {
        "kind": "climb",
        "robot": "scaler",
        "terrain": {"friction": 1.3, "scan": {"file": file, "holds": {}} | scan},
        "task": {
            "rounds": 2,
            "start": {"com": start.tolist(), "rpy_deg": rpy},
            "goal": {
                "com": (start + np.array([0, 0, 0.1])).tolist(),
                "rpy_deg": rpy,
                "tolerance": 0.03,
            },
            "stance": {name: [side * 0.18, end * 0.307, -0.26] for name, side, end in LEGS},
        },
        "posture": {"steps": {"com_max": 0.1, "toe_max": 0.16}},
        "trajectory": {"speed": 0.01, "swing_clearance": 0.025},
        "solver": {"time_limit": 100},
    }
    path = folder / "wall.yaml"
    path.write_text(yaml.safe_dump(spec, sort_keys=False))
    return path


def test_the_wall_of_a_scan_becomes_a_panel_where_it_stands(tmp_path: Path) -> None:
    ups = np.array([-0.1, 0.1])
    terrain = fit_scan(load_climb(climb(tmp_path, ups))).spec.terrain
    assert terrain.panel is not None
    assert terrain.scan is not None
    assert not terrain.scan.fit
    assert terrain.panel.heading_deg == pytest.approx(30.0, abs=0.5)
    assert terrain.panel.angle_deg == pytest.approx(90.0, abs=0.5)
    places = sorted(tuple(np.sign(hold.at).astype(int)) for hold in terrain.panel.holds.values())
    assert set(places) == {(-1, -1), (-1, 1), (1, -1), (1, 1)}


def test_a_robot_without_grippers_is_asked_for_an_opening(tmp_path: Path) -> None:
    path = climb(tmp_path, np.array([0.0]))
    text = path.read_text().replace("robot: scaler", "robot: silvia")
    path.write_text(text[: text.index("  stance:")] + text[text.index("posture:") :])
    with pytest.raises(SpecError, match="has no grippers; expected a robot that has"):
        fit_scan(load_climb(path))


def test_holds_are_either_found_or_stated(tmp_path: Path) -> None:
    path = climb(tmp_path, np.array([0.0]))
    spec = yaml.safe_load(path.read_text())
    spec["terrain"]["panel"] = {
        "across": [-1, 1],
        "along": [-1, 1],
        "holds": {"A": {"at": [0, 0]}},
    }
    path.write_text(yaml.safe_dump(spec))
    with pytest.raises(SpecError, match=r"terrain\.scan\.holds: expected either holds to be found"):
        load_climb(path)


@pytest.mark.slow
def test_a_cloud_is_climbed_by_grippers_in_one_command(tmp_path: Path) -> None:
    plan = climbplan.plan(climb(tmp_path, np.arange(-0.407, 0.52, 0.1)))
    assert plan.verify().passed
