"""Walks in the 3-D view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.walking.pages.scene import read_scene as walk_scene
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.schema.loading import load_mpc

SPEC = """\
kind: mpc
task: {knots: 3, integrator: mean, start: {velocity: [1, 0, 0]}}
solver: {time_limit: 60, gaits: 2}
"""


@pytest.fixture(scope="module")
def plan_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk_view")
    (folder / "short.yaml").write_text(SPEC)
    write_walk_plan(plan_walk(load_mpc(folder / "short.yaml")), folder / "plan.h5")
    return folder / "plan.h5"


def test_toes_forces_and_times(plan_path: Path) -> None:
    plan, scene = read_walk_plan(plan_path), walk_scene(plan_path)
    assert scene.rods is not None
    assert scene.forces is not None
    np.testing.assert_array_equal(scene.rods.ends[:, :, 1], plan.trajectory.toes)
    standing = plan.trajectory.gait.contact
    np.testing.assert_array_equal(scene.forces.force[standing], plan.trajectory.force[standing])
    assert (scene.forces.force[~standing] == 0).all()
    assert (scene.forces.mu[~standing] == 0).all()
    np.testing.assert_allclose(scene.time, 0.08 * np.arange(4))
    hips = np.linalg.norm(scene.rods.ends[:, :, 0] - plan.trajectory.state[:, None, :3], axis=-1)
    np.testing.assert_allclose(hips, hips[:1].repeat(4, axis=0))  # they turn with the body
    assert len(scene.shapes) == 1
