"""A short climb between walls to simulate, planned once."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from scenes import PlannedScenes
from short_climb import SHORT_CLIMB

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_text

Planned = Callable[..., ClimbPlan]


@pytest.fixture(scope="session")
def planned(planned_scenes: PlannedScenes) -> Planned:
    """Plans of the short climb with overrides, each made once."""
    pytest.importorskip("mujoco")
    made = {(): read_climb(planned_scenes["climb"])}

    def plan(*overrides: str) -> ClimbPlan:
        if overrides not in made:
            made[overrides] = plan_climb(load_text(SHORT_CLIMB, "short", list(overrides)))
        return made[overrides]

    return plan
