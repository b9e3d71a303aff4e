"""Rows of labelled terrains, as a worker makes them."""

from __future__ import annotations

from pathlib import Path

from climbplan.climb.envelopes.dataset_rows import TerrainRows
from climbplan.climb.schema.terrains_dataset import TerrainsProblemSpec
from climbplan.robots.any_robot import build_robot, require_no_flat_feet
from climbplan.schema.robots.source import load_any_robot


def build_terrain_source(spec: TerrainsProblemSpec, directory: Path) -> TerrainRows:
    """Return terrains as a spec describes them; a robot's file is looked up from `directory`."""
    return TerrainRows(
        spec,
        build_robot(
            require_no_flat_feet(load_any_robot(spec.robot, directory), "terrains of datasets")
        ),
    )
