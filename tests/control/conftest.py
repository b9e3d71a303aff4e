"""A short climb between walls, planned once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from short_climb import SHORT_CLIMB

import climbplan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb


@pytest.fixture(scope="session")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("climb") / "plan.h5"
    climbplan.plan(climbplan.load(SHORT_CLIMB)).save(path)
    return path


@pytest.fixture(scope="session")
def planned(plan_file: Path) -> Callable[..., ClimbPlan]:
    plan = read_climb(plan_file)
    return lambda: plan
