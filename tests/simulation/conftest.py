"""A short climb between walls to simulate, planned once."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner import plan_climb
from climbplan.spec.loading import load_text

SPEC = """
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.4]}
task:
  rounds: 1
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.05]}
force: {normal_force_weight: 2.0e-4}
"""
Planned = Callable[..., ClimbPlan]


@pytest.fixture(scope="session")
def planned() -> Planned:
    """Plans of the spec above with overrides, each made once."""
    pytest.importorskip("mujoco")
    made: dict[tuple[str, ...], ClimbPlan] = {}

    def plan(*overrides: str) -> ClimbPlan:
        if overrides not in made:
            made[overrides] = plan_climb(load_text(SPEC, "short", list(overrides)))
        return made[overrides]

    return plan
