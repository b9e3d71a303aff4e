"""Long climbs in windows of rounds: they join, reach the goal, and say what is proved of them."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import climbplan
from benchmarks.climb.triangle_walls import triangles
from climbplan.api.plan import Plan
from climbplan.climb.clearance.swing import SwingCollision
from climbplan.climb.motion import motion, tightening
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.postures.cost_bound import bound_posture_cost
from climbplan.climb.postures.planner import plan_postures
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.scene.within_reach import (
    find_reachable_surfaces,
    find_usable_surfaces,
    restrict_terrain,
    select_window,
)
from climbplan.climb.schema.loading import load_text
from climbplan.climb.windows.body_way import BodyPath
from climbplan.climb.windows.windows import plan_in_windows
from climbplan.errors import SpecError, Unresolved

# Two walls in panels of 0.4 m, of which a window comes to a few
PANELS = "".join(
    f"    - {{name: {side}{k}, rectangle: {{center: [{x}, {0.4 * k:.1f}, 0], "
    f"normal: [{-np.sign(x):.0f}, 0, 0], width: 0.4, height: 0.6}}}}\n"
    for side, x in (("l", -0.6), ("r", 0.6))
    for k in range(-2, 6)
)
SPEC = f"""\
kind: climb
robot: silvia
terrain:
  friction: 1.3
  regions:
{PANELS}task:
  rounds: auto
  start: {{com: [0, 0, 0]}}
  goal: {{com: [0, 0.9, 0]}}
"""
NUMBERED = SPEC.replace("rounds: auto", "rounds: 8")


def scene_of(text: str) -> ClimbScene:
    loaded = load_text(text, "spec")
    return build_scene(loaded.spec, loaded.robot)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Plan]:
    folder = tmp_path_factory.mktemp("windows")
    spec = folder / "long.yaml"
    spec.write_text(SPEC)
    return spec, climbplan.plan(spec)


def test_as_many_rounds_as_the_way_takes(made: tuple[Path, Plan]) -> None:
    _, plan = made
    assert plan.verify().passed
    assert plan.sizes["posture"]["windows"] >= 2
    assert 6 <= len(plan.rounds.com) - 1 <= 9  # 0.9 m in steps of 0.15 m
    assert f"rounds: {len(plan.rounds.com) - 1}" in plan.spec
    assert np.linalg.norm(plan.rounds.com[-1] - [0, 0.9, 0]) <= 0.02 + 1e-9


def test_the_plan_answers_a_spec_that_leaves_rounds_open(made: tuple[Path, Plan]) -> None:
    spec, plan = made
    plan.save(spec.with_name("plan.h5"))
    assert climbplan.verify(spec.with_name("plan.h5"), spec).passed
    other = spec.with_name("other.yaml")
    other.write_text(SPEC.replace("rounds: auto", f"rounds: {len(plan.rounds.com)}"))
    assert not climbplan.verify(spec.with_name("plan.h5"), other).passed


@pytest.mark.slow
def test_windows_of_a_stated_number_of_rounds_against_one_search(tmp_path: Path) -> None:
    spec = tmp_path / "long.yaml"
    spec.write_text(NUMBERED)
    windows = climbplan.plan(spec, overrides={"solver.window": 4, "solver.method": "micp"})
    whole = climbplan.plan(spec, overrides={"solver.method": "micp"})
    assert windows.verify().passed
    assert len(windows.rounds.com) == len(whole.rounds.com) == 9
    assert windows.status == "feasible"
    # The straight way bounds what one search proves, which bounds the windows
    assert 0 < windows.bound <= whole.bound + 1e-9 <= whole.objective + 2e-9
    assert whole.bound <= windows.objective
    assert windows.objective < 1.5 * whole.objective
    assert any("optimal a window at a time" in warning for warning in windows.warnings)


def test_nothing_that_rounds_can_come_to_is_left_out() -> None:
    scene = scene_of(NUMBERED)
    near = restrict_terrain(scene, 2)
    assert near.allowed.sum() < scene.terrain.allowed.sum()
    # Toes drawn within steps and reach stand on regions that are kept
    rng = np.random.default_rng(0)
    robot, steps = scene.robot, scene.spec.posture.steps
    for limb in range(robot.limb_count):
        points = scene.start.toes[limb] + rng.uniform(-1, 1, (400, 3)) * 2 * steps.toe_max
        far = np.linalg.norm(points - scene.start.toes[limb], axis=1) > 2 * steps.toe_max
        for point in points[~far]:
            for r in np.flatnonzero(~near.allowed[limb] & scene.terrain.allowed[limb]):
                assert scene.terrain.surfaces[r].distance(point) > 0


def test_what_one_search_chooses_is_among_the_alternatives_of_each_round() -> None:
    scene = scene_of(NUMBERED)
    rounds = plan_postures(scene).rounds
    found = find_reachable_surfaces(scene, 8)
    assert found.sum() < 8 * scene.terrain.allowed.sum()
    for j, limb in np.ndindex(8, 6):
        assert found[j, limb, rounds.region[j + 1, limb]]
    # And with these alternatives alone it is found again, at the same cost
    again = plan_postures(replace(scene, by_round=found))
    np.testing.assert_allclose(again.rounds.toes, rounds.toes, atol=2e-3)


def test_what_one_search_chooses_leads_on_to_the_goal() -> None:
    scene = scene_of(NUMBERED)
    rounds = plan_postures(scene).rounds
    found = find_usable_surfaces(scene)
    assert found.sum() < find_reachable_surfaces(scene, 8).sum()
    for j, limb in np.ndindex(8, 6):
        assert found[j, limb, rounds.region[j + 1, limb]]


def test_surfaces_are_chosen_by_an_l1_relaxation() -> None:
    chosen = NUMBERED + "solver: {method: sl1-relaxation}\n"
    found = plan_postures(scene_of(chosen))
    best = plan_postures(scene_of(NUMBERED))
    assert found.status == "feasible"
    assert found.bound is None  # rounding proves nothing
    assert best.bound is not None
    assert best.bound <= found.objective < 2 * best.objective
    assert found.nodes <= 10  # convex programs


def test_a_window_is_as_long_as_the_spec_says() -> None:
    assert select_window(scene_of(SPEC)) == 4
    assert select_window(scene_of(f"{SPEC}solver: {{window: 6}}\n")) == 6
    assert select_window(scene_of(NUMBERED)) is None
    assert select_window(scene_of(f"{NUMBERED}solver: {{window: 3}}\n")) == 3
    assert select_window(scene_of(f"{NUMBERED}solver: {{window: 8}}\n")) is None


def test_the_bound_of_straight_ways_is_met_by_equal_steps() -> None:
    scene = scene_of(NUMBERED)
    weights = scene.spec.posture.weights
    path = np.linalg.norm(scene.goal.com - scene.start.com)
    toes = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1)
    exact = (weights.com * path**2 + weights.toe * (toes**2).sum()) / 8
    assert 0.9 * exact < bound_posture_cost(scene) < exact


def test_ways_are_measured_along_their_corners() -> None:
    path = BodyPath(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], float))
    assert path.length == 2
    np.testing.assert_allclose(path.interpolate(1.25), [1, 0.25, 0])
    assert path.project(np.array([0.5, 0.1, 0]), 0.0) == pytest.approx(0.5)
    assert path.project(np.array([0.5, 0.1, 0]), 0.8) == pytest.approx(0.8)  # never back


def test_a_gap_that_no_window_crosses_is_told_with_its_place(tmp_path: Path) -> None:
    spec = tmp_path / "gap.yaml"
    kept = [line for line in SPEC.splitlines() if "l2," not in line and "r2," not in line]
    kept = [line for line in kept if "l1," not in line and "r1," not in line]
    spec.write_text("\n".join(kept) + "\nsolver: {method: micp}\n")
    with pytest.raises(Unresolved, match=r"window \d, after \d+ rounds and .* of 0.90 m"):
        climbplan.plan(spec)


def test_methods_that_plan_all_at_once_are_refused(tmp_path: Path) -> None:
    spec = tmp_path / "whole.yaml"
    for method in ("coupled", "sl1-relaxation"):  # which knows no cost that draws a window on
        spec.write_text(f"{SPEC}solver: {{method: {method}}}\n")
        with pytest.raises(
            SpecError, match=rf"whole.yaml:\d+: task.rounds: `{method}` plans a stated"
        ):
            climbplan.plan(spec)


def test_a_limb_that_meets_the_body_on_its_swing_is_planned_nearer_its_stance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    passed: Any = tightening.plan_swing_paths
    met: list[bool] = []

    def meets_once(*given: object) -> object:
        if met:
            return passed(*given)
        met.append(True)
        raise SwingCollision(2, "round 1, RR lifted", "RR's femur would be 3.0 mm deep in the body")

    monkeypatch.setattr(tightening, "plan_swing_paths", meets_once)
    found = motion.plan_motion(scene_of(NUMBERED), StageClock(lambda stage, fraction: None))
    assert len(found.tightenings) == 1
    assert found.tightenings[0].startswith("workspace of RR tightened: round 1, RR lifted")


@pytest.mark.slow
def test_a_thousand_regions_in_thirty_rounds(capsys: pytest.CaptureFixture[str]) -> None:
    found = {}
    for window in (2, 4, 8):
        scene = triangles(1000, gap=0.1, rounds=30, top=4.8, goal=(0.0, 0.0, 3.9))
        begin = time.process_time()
        timed = StageClock(lambda stage, fraction: None)
        motion = plan_in_windows(scene, window, timed, time.monotonic() + 300).supported.motion
        spent = time.process_time() - begin
        found[window] = motion.posture
        with capsys.disabled():
            cost, bound = motion.posture.objective, motion.posture.bound
            print(f"\nwindow {window}: {spent:.1f} s, cost {cost:.5f}, bound {bound:.5f}", end="")
    for posture in found.values():
        assert posture.rounds.count == 30
        assert posture.bound <= posture.objective <= 1.1 * posture.bound
