"""A short climb between walls, planned once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import climbplan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb

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


@pytest.fixture(scope="session")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("climb") / "plan.h5"
    climbplan.plan(climbplan.load(SPEC)).save(path)
    return path


@pytest.fixture(scope="session")
def planned(plan_file: Path) -> Callable[..., ClimbPlan]:
    plan = read_climb(plan_file)
    return lambda: plan
