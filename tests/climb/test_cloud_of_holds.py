"""One wall climbed by grippers on the holds that are found in a cloud of points."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import climbplan
from climbplan.errors import NoPlanFound
from climbplan.scan.holds import Grasping, find_wall_holds
from climbplan.scan.panel import build_panel
from climbplan.scan.reading import read_scan
from climbplan.scan.study import build_scan_spec
from climbplan.schema.robots.source import read_robot_text

ACROSS = (-0.18, 0.18)  # [m] where the scanned patch, smaller than a stance, is repeated
UP = -0.45 + 0.19 * np.arange(6)
BEFORE = 0.3595  # [m] of the body before the grips
OPENING = 0.07  # [m] of a gripper that the scanned holds fit into; the robot's own opens 50 mm


def repeated() -> dict[str, Any]:
    """The panel found in the shared cloud, its holds side by side and above each other."""
    folder = Path(os.environ.get("CLIMBPLAN_TERRAIN", "../shared/data/terrain"))
    file = folder / "vertical_bouldering_holds.pcd"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    panel = build_panel(
        find_wall_holds(read_scan(build_scan_spec(file, []), Path()), Grasping(OPENING))
    )
    own = list(panel["holds"].values())
    middle = np.mean([hold["at"] for hold in own], axis=0)
    places = [np.array([x, z]) - middle for x in ACROSS for z in UP]
    holds = [{**hold, "at": (place + hold["at"]).tolist()} for place in places for hold in own]
    return {
        **panel,
        "center": [0, 0, 0],
        "heading_deg": 0,
        "across": [-0.5, 0.5],
        "along": [-0.8, 0.9],
        "holds": {f"T{number}": hold for number, hold in enumerate(holds, start=1)},
    }


def climb(folder: Path, friction: float, safety: float) -> Path:
    """The spec of a climb, and beside it the robot with wider grippers."""
    own = read_robot_text("scaler")
    assert "finger_span: 0.05" in own
    (folder / "wide.yaml").write_text(own.replace("finger_span: 0.05", f"finger_span: {OPENING}"))
    panel = repeated()
    lean = np.deg2rad(panel["angle_deg"])
    up = np.array([0, np.cos(lean), np.sin(lean)])
    before = BEFORE * np.array([0, -np.sin(lean), np.cos(lean)])
    rpy = [panel["angle_deg"], 0, 0]
    stance = {
        name: [side * 0.18, end * 0.307, -0.26]
        for name, side, end in (("RF", 1, 1), ("RH", 1, -1), ("LH", -1, -1), ("LF", -1, 1))
    }
    goal = {"com": (before + 0.19 * up).tolist(), "rpy_deg": rpy, "tolerance": 0.03}
    spec = {
        "kind": "climb",
        "robot": "wide.yaml",
        "terrain": {"friction": friction, "panel": panel},
        "task": {
            "rounds": 4,
            "start": {"com": before.tolist(), "rpy_deg": rpy},
            "goal": goal,
            "stance": stance,
            "gait": ["LF", "RH", "RF", "LH"],
        },
        "posture": {"steps": {"com_max": 0.12, "toe_max": 0.14}},
        "force": {"safety_friction": safety, "safety_torque": 1.0},
        "solver": {"method": "micp", "time_limit": 300},
        "trajectory": {"speed": 0.007, "swing_clearance": 0.025},
    }
    path = folder / "wall.yaml"
    path.write_text(yaml.safe_dump(spec, sort_keys=False))
    return path


@pytest.mark.slow
def test_holds_of_a_cloud_are_climbed_where_friction_holds_their_sides(tmp_path: Path) -> None:
    assert climbplan.plan(climb(tmp_path, friction=1.5, safety=1.1)).verify().passed


@pytest.mark.slow
def test_sides_that_fingers_slip_off_are_refused_with_the_pull_that_is_missing(
    tmp_path: Path,
) -> None:
    with pytest.raises(NoPlanFound, match="pull towards the surface is missing"):
        climbplan.plan(climb(tmp_path, friction=0.9, safety=1.5))
