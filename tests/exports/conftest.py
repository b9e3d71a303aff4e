"""Plans of every kind that moves."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes import PlannedScenes


@pytest.fixture(scope="session")
def plans(planned_scenes: PlannedScenes) -> dict[str, Path]:
    """Plan files of a climb, a walk and a delivery by modules."""
    return {name: planned_scenes[name] for name in ("climb", "walk", "modules")}
