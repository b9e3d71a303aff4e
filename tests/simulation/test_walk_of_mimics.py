"""A quadruped with ankles geared to its knees walks, links and all."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker
from walking_urdf import WALK, write_robot

from climbplan.simulation.conditions import NOMINAL
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.schema.loading import load_mpc
from climbplan.walking.simulation.whole_body_replay import simulate_whole_body


@pytest.fixture(scope="module", name="plan")
def _plan(tmp_path_factory: pytest.TempPathFactory) -> WalkPlan:
    folder = tmp_path_factory.mktemp("mimics")
    write_robot(folder, Walker(joints=4))
    text = re.sub(
        r'(<joint name="(\w+)_ankle".*?)(</joint>)',
        r'\1<mimic joint="\2_knee" multiplier="-0.5" offset="0.1"/>\3',
        (folder / "walker.urdf").read_text(),
        flags=re.DOTALL,
    )
    (folder / "walker.urdf").write_text(text)
    (folder / "walk.yaml").write_text(WALK.replace("knots: 4", "knots: 8"))
    return plan_walk(load_mpc(folder / "walk.yaml"))


@pytest.mark.slow
def test_it_walks_as_planned(plan: WalkPlan, tmp_path: Path) -> None:
    legs = plan.task.legs
    assert legs is not None
    assert legs.there.sum() == 12
    assert legs.mimics.sum() == 4
    write_walk_plan(plan, tmp_path / "plan.h5")
    stored = read_walk_plan(tmp_path / "plan.h5").task.legs
    assert stored is not None
    np.testing.assert_array_equal(stored.chain.drives, legs.chain.drives)
    run = simulate_whole_body(plan, NOMINAL)
    assert not run.fallen
    assert run.num_unsolved == 0
    off = np.linalg.norm(run.com - plan.trajectory.state[: len(run.com), :3], axis=1)
    assert off.max() < 0.08  # legs that weigh lag behind where the plan speeds up at 2.3 m/s^2
    assert (run.torque[:, ~legs.there] == 0).all()
