"""Spherical feet beside edges: where toes are set down, and ground that has no room for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from walking_urdf import walking_robot

from climbplan.errors import SpecError
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import WalkTask

pytest.importorskip("pinocchio")

FOOT = 0.02


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("feet")


def task_on(folder: Path, rise: float, more: dict[str, Any], foot: str = "") -> WalkTask:
    regions = [
        {"name": "floor", "x": [-1, 0.4], "y": [-1, 1]},
        {"name": "step", "x": [0.4, 2], "y": [-1, 1], "height": rise},
    ]
    spec = {"kind": "mpc", "terrain": {"regions": regions, **more}}
    return build_task(MpcSpec.model_validate(spec), walking_robot(folder, None, foot))


def test_toes_are_as_far_from_edges_as_feet_are_wide(folder: Path) -> None:
    assert task_on(folder, 0.03, {}).ground.edge == 0.0
    assert task_on(folder, 0.03, {}, f"foot: {{radius: {FOOT}}}").ground.edge == FOOT
    assert task_on(folder, 0.0, {"edge": 0.01}, f"foot: {{radius: {FOOT}}}").ground.edge == 0.01


def test_feet_that_stand_in_the_side_of_a_step_are_refused(folder: Path) -> None:
    with pytest.raises(SpecError, match=r"stand in the side of 'step', 0\.03 m above 'floor'"):
        task_on(folder, 0.03, {"edge": 0.01}, f"foot: {{radius: {FOOT}}}")


def test_feet_without_room_are_refused(folder: Path) -> None:
    floor = {"name": "floor", "x": [-1, 2], "y": [-1, 1]}
    beam = {"name": "beam", "x": [2, 3], "y": [0, 0.03]}
    spec = {"kind": "mpc", "terrain": {"regions": [floor, beam]}}
    with pytest.raises(SpecError, match="no room within the edges of 'beam'"):
        build_task(
            MpcSpec.model_validate(spec), walking_robot(folder, None, f"foot: {{radius: {FOOT}}}")
        )
