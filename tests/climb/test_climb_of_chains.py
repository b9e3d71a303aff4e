"""Every method of a climb plans a robot from a URDF, to a plan that is verified."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.coupled.planner import plan_coupled
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.model import COUPLED_METHODS
from climbplan.robots.serial_chain import SerialChain

SPECS = Path(__file__).parents[2] / "specs"
ONE_ROUND = ["task.rounds=1", "task.goal.com=[0, 0, 0.12]"]
METHODS = ("micp", "nlp", "sl1-relaxation", *COUPLED_METHODS)


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walker")
    for name in ("climb_walker.yaml", "robot_walker.yaml", "walker.urdf"):
        shutil.copy(SPECS / name, folder)
    return folder / "climb_walker.yaml"


@pytest.mark.parametrize("method", ["coupled-modes", "coupled-minlp-scip"])
def test_coupled_postures_of_a_chain(spec: Path, method: str) -> None:
    loaded = load_climb(spec, [*ONE_ROUND, f"solver.method={method}"])
    scene = build_scene(loaded.spec, loaded.robot, loaded.source)
    assert isinstance(scene.robot.mechanism, SerialChain)
    found = plan_coupled(scene)
    assert found.bound is not None
    assert found.bound <= found.objective + 1e-9
    np.testing.assert_allclose(found.rounds.com[-1], [0, 0, 0.12], atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_climb_by_every_method(spec: Path, method: str, tmp_path: Path) -> None:
    plan = plan_climb(load_climb(spec, [*ONE_ROUND, f"solver.method={method}"]))
    write_climb(plan, tmp_path / "plan.h5")
    verification = verify_plan(read_climb(tmp_path / "plan.h5"))
    assert verification.passed, verification.table()
