"""A short climb between walls."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import PlannedScenes

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb


@pytest.fixture(scope="session")
def plan_file(planned_scenes: PlannedScenes) -> Path:
    return planned_scenes["climb"]


@pytest.fixture(scope="session")
def planned(plan_file: Path) -> Callable[..., ClimbPlan]:
    plan = read_climb(plan_file)
    return lambda: plan
