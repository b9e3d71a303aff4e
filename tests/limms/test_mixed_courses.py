"""Courses of unlike legs: every manoeuvre begins wherever the one before it ended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limms_scenes import loaded, scene

from climbplan.limms.arms.carrying import plan_carrying
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.motion.assembly import build_initial_plan
from climbplan.limms.motion.between_subtasks import release_box, retarget
from climbplan.limms.motion.timeline import DRIVES, STABLE
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner import planner
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.limms_scene import ModuleScene, build_scene
from climbplan.limms.schema.loading import LoadedLimms, load_limms
from climbplan.limms.task_planning.best_first_search import search_task_plans
from climbplan.limms.task_planning.relaxed_actions import (
    compute_cost_to_go,
    list_places,
    relax_actions,
)
from climbplan.limms.task_planning.single_actions import find_single_actions
from climbplan.verification.verification import Verification

# The box is below a ledge, its goal over it; nothing comes from the ground to the anchor over the
# ledge, and nothing reaches the goal from the one below it
LEDGE = """\
kind: limms
terrain:
  friction: 0.8
  regions:
    - {name: low, lower: [-1.4, -0.6, 0], upper: [0, 0.6, 2]}
    - {name: ledge, lower: [0, -0.6, 0.35], upper: [1.0, 0.6, 2]}
  anchors:
    - {name: low wall, position: [-0.15, 0.6, 0.6], normal: [0, -1, 0]}
    - {name: high wall, position: [0.35, 0.6, 0.95], normal: [0, -1, 0]}
box: {size: [0.2, 0.2, 0.2], mass: 0.3, start: [-0.35, -0.1, 0.1], goal: [0.4, 0, 1.35]}
modules:
  - {name: A, position: [-1.0, 0.3, 0]}
"""
# No anchor is near the box: legs bring it to where an arm takes it
HALL = """\
kind: limms
terrain:
  friction: 0.8
  regions:
    - {name: hall, lower: [-1.5, -1.5, 0], upper: [2.5, 1.5, 2.0]}
  anchors:
    - {name: east, position: [2.5, 0.0, 0.7], normal: [-1, 0, 0]}
box: {size: [0.3, 0.3, 0.3], mass: 0.4, start: [0.6, 0, 0.15], goal: [2.0, 0.0, 1.1]}
modules:
  - {name: A, position: [-0.9, 0.7, 0]}
  - {name: B, position: [-0.9, -0.7, 0]}
  - {name: C, position: [-0.9, 0.2, 0]}
  - {name: D, position: [-0.9, -0.2, 0]}
"""


def read(folder: Path, text: str) -> LoadedLimms:
    path = folder / "room.yaml"
    path.write_text(text, encoding="utf-8")
    return load_limms(path)


@pytest.fixture(scope="module")
def ledge(tmp_path_factory: pytest.TempPathFactory) -> LoadedLimms:
    return read(tmp_path_factory.mktemp("mixed"), LEDGE)


def kinds_of(own: ModuleScene) -> list[tuple[str, ...]]:
    return [
        tuple(leg.action.kind for leg in course.subtasks)
        for course in search_task_plans(build_initial_plan(own))
    ]


def test_a_box_is_carried_and_then_lifted_from_over_it(ledge: LoadedLimms) -> None:
    assert not find_single_actions(build_scene(ledge)).actions  # no single action does it
    plan = plan_limms(ledge)
    assert verify_plan(plan).passed
    assert plan.sequence.startswith("relay: arms: low wall to ")
    assert ", then relatch: high wall to " in plan.sequence
    modes = plan.motion.box_mode[:, 0]
    assert list(modes[np.flatnonzero(np.diff(modes, prepend=0))])[:3] == [1, 3, 1]
    high = plan.anchor_names.index("high wall")
    held = (plan.motion.base_anchor[-1, 0], plan.motion.tip_anchor[-1, 0])
    assert high in held


def test_the_bound_of_legs_is_that_of_what_is_listed(ledge: LoadedLimms) -> None:
    start = build_initial_plan(build_scene(ledge))
    places = list_places(start.scene)
    left = compute_cost_to_go(relax_actions(start.scene, places, frozenset(), {}), 1, len(places))
    found = list(search_task_plans(start))
    assert min(len(course.subtasks) for course in found) == left[0] == 2
    costs = [course.cost() for course in found]
    assert costs == sorted(costs)


def test_legs_may_come_before_arms(tmp_path: Path) -> None:
    own = build_scene(read(tmp_path, HALL))
    assert ("quadruped", "arms") in kinds_of(own)
    never = replace(own, allow=tuple(what for what in own.allow if what != "quadruped"))
    assert not kinds_of(never)


@pytest.mark.slow
def test_legs_bring_a_box_to_an_arm(tmp_path: Path) -> None:
    plan = plan_limms(read(tmp_path, HALL))
    assert verify_plan(plan).passed
    assert plan.sequence.startswith("relay: quadruped, then arms: east to ")


def test_worlds_are_headed_from_where_everything_is() -> None:
    own = scene("limms_lift_light", "box.mass=0.4")
    start = build_initial_plan(own)
    place = own.box_start[0] + np.array([0.05, 0.0, 0.0])
    begun = retarget(start, place)
    assert np.allclose(begun.scene.start_placement, own.start_placement)
    assert np.allclose(begun.scene.goal_placement, place)
    assert begun.scene.arrival_speed == 0
    arms = next(
        action for action in find_single_actions(begun.scene).actions if action.num_modules == 1
    )
    after = plan_carrying(
        begun, arms, SearchBudget(600.0, 50), np.random.default_rng(0), settle=release_box
    )
    assert after is not None
    assert after.box_mode == STABLE
    assert np.allclose(after.box, place)
    owner = int(np.flatnonzero(after.tip_anchor >= own.wall_offset)[0])
    onward = retarget(after, own.goal_placement, 0.5)
    assert np.allclose(onward.scene.start_placement, place)
    assert onward.scene.arrival_speed == 0.5
    anchor = own.wall_offset + arms.connections[0].root
    assert onward.scene.start_anchor[owner] == anchor
    assert (np.delete(onward.scene.start_anchor, owner) == -1).all()
    assert (np.delete(after.mode, owner) == DRIVES).all()


@pytest.mark.slow
def test_a_plan_that_fails_its_checks_makes_the_search_go_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judged: list[Verification] = []

    def harsh(plan: LimmsPlan) -> Verification:
        """Verified as it is, but the first plan with a module out of its place."""
        motion = plan.motion
        if not judged:
            motion = replace(motion, joint_angles=motion.joint_angles + 0.01)
        judged.append(verify_plan(replace(plan, motion=motion)))
        return judged[-1]

    monkeypatch.setattr(planner, "verify_plan", harsh)
    plan = plan_limms(loaded("limms_lift_light", "box.mass=0.4", "box.goal=[0.15, 0, 0.5]"))
    assert [verification.passed for verification in judged] == [False, True]
    assert verify_plan(plan).passed
    assert any("checks failed" in line for line in plan.summary)
