"""Swings beside a scan: ways with room to spare come first, in their order."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import trimesh

from climbplan.climb.clearance.swing import TOE_CLEARANCE, _order_by_clearance
from climbplan.terrain.raw_surface import RawSurface

TOP = 0.1  # [m] of a box about the origin


def over(room: float) -> np.ndarray:
    """A way level over the box, so far from it."""
    return np.array([[-0.2, 0.0, TOP + room], [0.2, 0.0, TOP + room]])


def scene(lift: float) -> Any:
    box = trimesh.creation.box(bounds=[[-0.1, -0.1, 0.0], [0.1, 0.1, TOP]])
    scan = RawSurface(np.array(box.vertices), np.array(box.faces, np.int64), 0.005, 0.01)
    spec = SimpleNamespace(trajectory=SimpleNamespace(swing_clearance=lift))
    robot = SimpleNamespace(foot=None)
    return cast("Any", SimpleNamespace(terrain=SimpleNamespace(scan=scan), spec=spec, robot=robot))


def heights(lift: float, rooms: list[float]) -> list[float]:
    ways = _order_by_clearance(scene(lift), (over(room) for room in rooms))
    return [round(float(way[0, 2] - TOP), 3) for way in ways]


def test_what_has_room_to_spare_comes_before_what_is_nearer() -> None:
    assert heights(0.06, [0.012, 0.04, 0.02, 0.031]) == [0.04, 0.031, 0.012, 0.02]


def test_a_low_lift_asks_for_no_more_than_half_of_it() -> None:
    assert heights(0.03, [0.012, 0.016, 0.04]) == [0.016, 0.04, 0.012]
    order = [0.05, TOE_CLEARANCE, 0.04]
    assert heights(2 * TOE_CLEARANCE, order) == order
