"""Coupled climbs: slippery patches, the exact balance, and what cannot be held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.climb.random_climbs import random_climb
from climbplan.climb.coupled.envelopes import (
    braced_envelope,
    load_envelope,
    opposite,
    select_envelopes,
)
from climbplan.climb.coupled.planner import plan_coupled
from climbplan.climb.coupled.preparation import CoupledProblem, prepare_problem
from climbplan.climb.coupled.stages import (
    solve_first_stage,
    solve_first_stage_with_regions,
    solve_nonlinear,
    solve_second_stage,
)
from climbplan.climb.coupled.statement import compute_scene_load, formulate_coupled_program
from climbplan.climb.postures.planner import plan_postures
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import Unresolved, UsageError

EXPERT = "solver.envelopes=[expert]"


def _scene(*overrides: str) -> ClimbScene:
    loaded = load_climb("specs/climb_patches.yaml", [EXPERT, *overrides])
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
    local = plan_coupled(_scene("task.rounds=3", "solver.method=coupled-nlp"))
    assert local.objective >= coupled.bound - 1e-6
    assert "IPOPT" in local.solver
    assert not np.isin(coupled.rounds.region, patches).any()
    for j in range(coupled.rounds.count + 1):
        for limb in range(scene.robot.limb_count):
            surface = scene.terrain.surfaces[coupled.rounds.region[j, limb]]
            assert surface.distance(coupled.rounds.toes[j, limb]) <= 1e-6


@pytest.fixture(scope="module")
def prepared() -> CoupledProblem:
    """Three rounds on the slippery patches."""
    return prepare_problem(_scene("task.rounds=3"), PostureMargins())


@pytest.fixture(scope="module")
def stages(prepared: CoupledProblem) -> tuple[CoupledProblem, np.ndarray]:
    """A scene and the point that P1 and P2 find on it: toes and forces, (M, N, 6)."""
    pinned = prepared.fix_choices(prepared.guess, prepared.assignment)
    x = solve_first_stage(prepared, pinned, braced_envelope(prepared.scene))
    assert x is not None
    projected = solve_second_stage(prepared.program, pinned, x)
    assert projected is not None
    force = prepared.program.variables["force"]
    np.testing.assert_array_equal(projected[: force.start], x[: force.start])
    assert prepared.instance.violation(projected) <= 1e-6
    values = {n: prepared.program.value(n, projected) for n in prepared.program.variables}
    return prepared, np.concatenate([values["toe"], values["force"]], axis=2)


def test_second_stage_balances_about_the_body(stages: tuple[CoupledProblem, np.ndarray]) -> None:
    """Forces add up to the weight and turn nothing about where it acts, which is one point."""
    prepared, both = stages
    toe, force = both[..., :3], both[..., 3:]
    np.testing.assert_allclose(force.sum(axis=1), np.tile([0, 0, 1.0], (3, 1)), atol=1e-6)
    about = np.cross(toe - prepared.origin[:, None], force).sum(axis=1)
    # A vertical load somewhere leaves no moment about the vertical
    np.testing.assert_allclose(about[:, 2], 0, atol=1e-6)


def test_forces_stay_in_the_exact_cone(stages: tuple[CoupledProblem, np.ndarray]) -> None:
    prepared, both = stages
    pressure = np.abs(both[..., 3])
    shear = np.linalg.norm(both[..., 4:], axis=2)
    assert (shear <= pressure / prepared.scene.spec.force.safety_friction + 1e-6).all()
    assert (both[..., 5] >= prepared.scene.spec.posture.min_load - 1e-6).all()


def test_first_stage_finds_regions_itself(prepared: CoupledProblem) -> None:
    found = solve_first_stage_with_regions(prepared, braced_envelope(prepared.scene), 20.0)
    assert found is not None
    pinned = prepared.fix_choices(prepared.guess, prepared.assignment)
    given = solve_first_stage(prepared, pinned, braced_envelope(prepared.scene))
    assert given is not None
    costs = [prepared.instance.objective(x) for x in (found.x, given)]
    assert costs[0] <= costs[1] * (1 + 1e-3)


def test_moments_about_other_points_are_the_same_problem(prepared: CoupledProblem) -> None:
    """A point of P stays one when moments are taken elsewhere: forces add up to the load."""
    pinned = prepared.fix_choices(prepared.guess, prepared.assignment)
    x = solve_nonlinear(pinned, prepared.guess, 20.0)
    assert x is not None
    moved = prepared.origin + np.array([0.3, -0.2, 1.0])
    elsewhere = formulate_coupled_program(prepared.scene, PostureMargins(), moved)
    assert elsewhere.instantiate().violation(x) <= 2e-6
    shifted = x.copy()
    shifted[prepared.program.variables["force"].start] += 1e-2
    assert elsewhere.instantiate().violation(shifted) > 1e-3


def test_forces_that_cost_are_smaller() -> None:
    free, dear = (
        plan_coupled(_scene("task.rounds=3", f"posture.weights.{w}"))
        for w in ("force=0", "force=0.001")
    )
    assert dear.objective > free.objective
    assert dear.bound is not None
    assert dear.bound <= dear.objective


def test_a_payload_is_part_of_the_load() -> None:
    load = compute_scene_load(_scene("task.payload.mass=2.06", "task.payload.offset=[0.1, 0, 0]"))
    np.testing.assert_allclose(load.force, [0, 0, -1.2], atol=1e-9)
    np.testing.assert_allclose(load.moment, [0, 0.02, 0], atol=1e-9)


def test_walls_that_hold_nothing_are_named() -> None:
    scene = _scene("terrain.friction=0.002")
    with pytest.raises(Unresolved, match=r"no region holds the load.* for RF, RM"):
        plan_coupled(scene)


def test_envelopes_that_do_not_exist_are_refused() -> None:
    scene = _scene()
    with pytest.raises(UsageError, match=r"unknown envelope 'wal5'.*wall5, expert"):
        load_envelope(scene, "wal5")


@pytest.mark.parametrize(("climb", "legs", "name"), [(35, 4, "expert"), (1, 6, "wall5")])
def test_a_robot_without_a_shipped_envelopes_limbs_has_the_experts(
    climb: int, legs: int, name: str, tmp_path: Path
) -> None:
    loaded = load_climb(random_climb(climb, tmp_path), [])
    scene = build_scene(loaded.spec, loaded.robot, loaded.source)
    assert scene.robot.limb_count == legs
    assert [one.name for one in select_envelopes(scene)] == [name]
    modes = ["ground3", "wall5"] if legs == 6 else ["expert-ground", "expert"]
    chosen = select_envelopes(scene, several=True)
    assert [one.name for one in chosen] == modes
    if legs == 4:
        ground, braced = (one.box for one in chosen)
        assert (ground.upper <= braced.upper).all()
        assert (ground.lower >= braced.lower).all()
        with pytest.raises(UsageError, match=r"do not fit .* `expert`, `expert-ground`, or a"):
            load_envelope(scene, "wall5")


def test_limbs_have_mirror_images() -> None:
    robot = _scene().robot
    names = robot.limb_names
    pairs = {names[k]: names[opposite(robot, k)] for k in range(robot.limb_count)}
    assert pairs == {"RF": "LF", "RM": "LM", "RR": "LR", "LR": "RR", "LM": "RM", "LF": "RF"}
