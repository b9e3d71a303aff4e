"""Plans for all tests of this folder, planned once: the throw, and a box that is turned."""

from __future__ import annotations

from pathlib import Path

import pytest
from limms_scenes import loaded
from scenes import PlannedScenes

from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms


@pytest.fixture(scope="session")
def throw(throw_file: Path) -> LimmsPlan:
    return read_limms_plan(throw_file)


@pytest.fixture(scope="session")
def turned() -> LimmsPlan:
    return plan_limms(loaded("limms_turned"))


@pytest.fixture(scope="session")
def throw_file(planned_scenes: PlannedScenes) -> Path:
    return planned_scenes["modules"]
