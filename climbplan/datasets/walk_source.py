"""Rows of walks, as a worker makes them."""

from __future__ import annotations

from pathlib import Path

from climbplan.spec.datasets.walks import WalksProblemSpec
from climbplan.spec.walking.loading import load_body
from climbplan.walking.dataset_rows import WalkRows


def walk_source(spec: WalksProblemSpec, directory: Path) -> WalkRows:
    """Walks as a spec describes them; a robot's file is looked up from `directory`."""
    return WalkRows(spec, load_body(spec.robot, directory))
