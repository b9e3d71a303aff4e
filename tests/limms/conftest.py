"""Plans for all tests of this folder, planned once: the throw, and a box that is turned."""

from __future__ import annotations

from pathlib import Path

import pytest
from limms_scenes import loaded

from climbplan.limms.plan import LimmsPlan
from climbplan.limms.plan_file import write_limms_plan
from climbplan.limms.planner import plan_limms


@pytest.fixture(scope="session")
def throw() -> LimmsPlan:
    return plan_limms(loaded("limms_throw"))


@pytest.fixture(scope="session")
def turned() -> LimmsPlan:
    return plan_limms(loaded("limms_turned"))


@pytest.fixture(scope="session")
def throw_file(throw: LimmsPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("limms") / "plan.h5"
    write_limms_plan(throw, path)
    return path
