"""Coupled climbs: slippery patches, the exact balance, and what cannot be held."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.climb.coupled.envelopes import braced_envelope
from climbplan.climb.coupled.planner import first_stage, plan_coupled, second_stage
from climbplan.climb.coupled.statement import coupled_program, loadable, reference
from climbplan.climb.postures.planner import plan_postures
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene import ClimbScene, build_scene
from climbplan.errors import Infeasible
from climbplan.reformulations.pinned import PinnedForm
from climbplan.spec.loading import load_climb


def _scene(*overrides: str) -> ClimbScene:
    loaded = load_climb("specs/climb_patches.yaml", overrides)
    return build_scene(loaded.spec, loaded.robot, loaded.source)


def _slippery(scene: ClimbScene) -> list[int]:
    return [k for k, region in enumerate(scene.terrain.regions) if "patch" in region.name]


def test_toes_keep_off_slippery_patches_where_decoupled_ones_do_not() -> None:
    scene = _scene("task.rounds=3")
    patches = _slippery(scene)
    assert np.isin(plan_postures(scene).rounds.region, patches).any()
    coupled = plan_coupled(scene)
    assert coupled.bound is not None
    assert coupled.bound <= coupled.objective + 1e-9
    assert plan_coupled(scene, whole=True).objective >= coupled.bound - 1e-6
    assert not np.isin(coupled.rounds.region, patches).any()
    for j in range(coupled.rounds.count + 1):
        for limb in range(scene.robot.limb_count):
            surface = scene.terrain.surfaces[coupled.rounds.region[j, limb]]
            assert surface.distance(coupled.rounds.toes[j, limb]) <= 1e-6


@pytest.fixture(scope="module")
def stages() -> tuple[ClimbScene, np.ndarray]:
    """A scene and the point that P1 and P2 find on it."""
    scene = _scene("task.rounds=3")
    box = braced_envelope(scene)
    scene = loadable(scene, box)
    program = coupled_program(scene, PostureMargins(), box)
    instance = program.at()
    found = plan_postures(scene)
    guess = np.clip(np.zeros(instance.size), instance.lower, instance.upper)
    for name, value in (("toe", found.rounds.toes[1:]), ("com", found.rounds.com[1:])):
        block = program.variables[name]
        guess[block.start : block.stop] = value.ravel()
    pinned = PinnedForm.of(instance).at(guess, instance.assignment(guess), compact=True)
    x = first_stage(scene, program, pinned, box)
    assert x is not None
    projected = second_stage(program, pinned, x)
    assert projected is not None
    toe, com = program.variables["toe"], program.variables["com"]
    np.testing.assert_array_equal(projected[: com.stop], x[: com.stop])
    assert toe.start == 0
    assert instance.violation(projected) <= 1e-6
    values = {n: program.value(n, projected) for n in program.variables}
    return scene, np.concatenate([values["toe"], values["force"]], axis=2)


def test_second_stage_balances_about_the_body(stages: tuple[ClimbScene, np.ndarray]) -> None:
    """Forces add up to the weight and turn nothing about where it acts, which is one point."""
    scene, both = stages
    toe, force = both[..., :3], both[..., 3:]
    np.testing.assert_allclose(force.sum(axis=1), np.tile([0, 0, 1.0], (3, 1)), atol=1e-6)
    about = np.cross(toe - reference(scene)[:, None], force).sum(axis=1)
    # A vertical load somewhere leaves no moment about the vertical
    np.testing.assert_allclose(about[:, 2], 0, atol=1e-6)


def test_forces_stay_in_the_exact_cone(stages: tuple[ClimbScene, np.ndarray]) -> None:
    scene, both = stages
    pressure = np.abs(both[..., 3])
    shear = np.linalg.norm(both[..., 4:], axis=2)
    assert (shear <= pressure / scene.spec.force.safety_friction + 1e-6).all()
    assert (both[..., 5] >= 0.04 - 1e-6).all()


def test_walls_that_hold_nothing_are_named() -> None:
    scene = _scene("terrain.friction=0.002")
    with pytest.raises(Infeasible, match=r"RF, RM.*no region holds the load"):
        plan_coupled(scene)
