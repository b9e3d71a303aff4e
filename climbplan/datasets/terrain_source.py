"""Rows of labelled terrains, as a worker makes them."""

from __future__ import annotations

from pathlib import Path

from climbplan.climb.envelopes.dataset_rows import TerrainRows
from climbplan.robots.model import Robot
from climbplan.spec.datasets.model import TerrainsProblemSpec
from climbplan.spec.robots.source import load_robot


def terrain_source(spec: TerrainsProblemSpec, directory: Path) -> TerrainRows:
    """Terrains as a spec describes them; a robot's file is looked up from `directory`."""
    return TerrainRows(spec, Robot.from_spec(load_robot(spec.robot, directory)))
