"""Rows of walks, as a worker makes them."""

from __future__ import annotations

from pathlib import Path

from climbplan.walking.online.dataset_rows import WalkRows
from climbplan.walking.schema.dataset import WalksProblemSpec
from climbplan.walking.schema.loading import load_body


def build_walk_source(spec: WalksProblemSpec, directory: Path) -> WalkRows:
    """Return walks as a spec describes them; a robot's file is looked up from `directory`."""
    return WalkRows(spec, load_body(spec.robot, directory))
