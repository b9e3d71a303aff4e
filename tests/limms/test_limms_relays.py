"""Relays: the box is put down on the way, modules come down from walls and go to others."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from limms_scenes import loaded

from climbplan.limms.check.verification import verify_plan
from climbplan.limms.motion.assembly import build_initial_plan, latch_arm
from climbplan.limms.motion.climbing_down import climb_down
from climbplan.limms.motion.timeline import DRIVES, NOWHERE
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.bounds import Connection, is_within_reach
from climbplan.limms.scene.limms_scene import ModuleScene, build_scene
from climbplan.limms.schema.loading import LoadedLimms, load_limms
from climbplan.limms.task_planning.best_first_search import list_task_plans, search_task_plans
from climbplan.limms.task_planning.relaxed_actions import list_standing_places
from climbplan.limms.task_planning.single_actions import find_single_actions

# One module; no anchor serves both the start of the box and its goal
HALL = """\
kind: limms
terrain:
  regions:
    - {name: hall, lower: [-1.6, -0.6, 0], upper: [1.6, 0.7, 1.8]}
  anchors:
    - {name: west, position: [-0.6, 0.7, 0.6], normal: [0, -1, 0]}
    - {name: east, position: [0.3, 0.7, 0.6], normal: [0, -1, 0]}
box: {size: [0.2, 0.2, 0.2], mass: 0.3, start: [-0.9, 0.1, 0.1], goal: [0.7, 0.1, 0.4]}
modules:
  - {name: A, position: [-0.3, -0.3, 0]}
"""


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> LoadedLimms:
    path = tmp_path_factory.mktemp("relay") / "hall.yaml"
    path.write_text(HALL, encoding="utf-8")
    return load_limms(path)


@pytest.fixture(scope="module")
def scene(hall: LoadedLimms) -> ModuleScene:
    return build_scene(hall)


def test_relays_lead_from_leg_to_leg_within_reach(scene: ModuleScene) -> None:
    found = list(search_task_plans(build_initial_plan(scene)))
    assert found
    fewest = [relay for relay in found if len(relay.subtasks) == 2]
    assert found[: len(fewest)] == fewest  # first
    assert all(len(relay.subtasks) == 3 for relay in found[len(fewest) :])  # one more at most
    assert [relay.cost() for relay in found] == sorted(relay.cost() for relay in found)
    for relay in found:
        assert relay.subtasks[0].start == tuple(scene.box_start[0])
        assert relay.subtasks[-1].end == tuple(scene.goal)
        for leg, onward in itertools.pairwise(relay.subtasks):
            assert leg.end == onward.start
        for leg in relay.subtasks:
            for place in (leg.start, leg.end):
                assert is_within_reach(scene, leg.action.connections, np.array(place))
    spots = list_standing_places(scene)
    assert np.allclose(spots[:, 2], 0.1)
    assert (np.abs(spots[:, 0]) <= 1.5 + 1e-9).all()
    away = np.abs(spots[:, :2] - scene.start_position[0, :2])
    assert (away > 0.13).any(axis=1).all()  # not on the module


def test_one_leg_comes_first_where_it_serves(tmp_path: Path) -> None:
    path = tmp_path / "near.yaml"
    path.write_text(HALL.replace("goal: [0.7, 0.1, 0.4]", "goal: [-0.5, 0.1, 0.4]"), "utf-8")
    near = build_scene(load_limms(path))
    assert is_within_reach(near, (Connection(0, 2),), near.goal)
    listed = list(list_task_plans(build_initial_plan(near), find_single_actions(near).actions))
    assert len(listed[0].subtasks) == 1
    assert listed[0].cost() + 1 < min(
        course.cost() for course in listed if len(course.subtasks) > 1
    )
    walk = build_scene(
        loaded("limms_walk")
    )  # no anchor at all: one walk, and no second one after it
    assert not list(search_task_plans(build_initial_plan(walk)))


def test_a_module_comes_down_from_a_wall(scene: ModuleScene) -> None:
    rng = np.random.default_rng(0)
    world, _ = latch_arm(build_initial_plan(scene), 0, 1, "A", rng)
    before = len(world.stretches)
    down = climb_down(world, 0, rng)
    assert down.mode[0] == DRIVES
    assert down.tip_anchor[0] == NOWHERE
    assert down.grounded[0] == 0
    assert np.allclose(down.angles[0], 0.0, atol=1e-9)
    assert down.base_position[0, 2] == 0.0
    joined = down.stretches[before - 1 :]
    for one, other in itertools.pairwise(joined):
        assert np.abs(one.angles[-1] - other.angles[0]).max() < 1e-6
        assert np.abs(one.base_position[-1] - other.base_position[0]).max() < 1e-6
    # Its first end is on the wall for as long as the last one is not on the ground
    assert [int(s.tip_anchor[0]) for s in joined].index(NOWHERE) > 0


@pytest.mark.slow
def test_one_module_carries_a_box_past_its_reach(hall: LoadedLimms) -> None:
    plan = plan_limms(hall)
    assert verify_plan(plan).passed
    assert plan.sequence.startswith("relay: arms: west to ")
    assert "then arms: east to " in plan.sequence
    modes = plan.motion.box_mode[:, 0]
    changes = modes[np.flatnonzero(np.diff(modes, prepend=0))]
    assert list(changes) == [1, 3, 1, 3]  # stands, is held, stands, is held


def test_a_throw_may_follow_a_carry(tmp_path: Path) -> None:
    text = HALL.replace("goal: [0.7, 0.1, 0.4]", "goal: [0.4, 0.1, 1.42], arrival_speed: 1.5")
    path = tmp_path / "high.yaml"
    path.write_text(text, encoding="utf-8")
    high = build_scene(load_limms(path))
    found = list(search_task_plans(build_initial_plan(high)))
    assert found
    for relay in found:
        if len(relay.subtasks) == 2:
            assert [leg.action.kind for leg in relay.subtasks] == ["arms", "throw"]
            assert [leg.action.connections[0].root for leg in relay.subtasks] == [0, 1]
    assert len(found[0].subtasks) == 2
    # From the first anchor the goal is too far to be among the first throws to try
    (far, *_) = find_single_actions(high).actions
    assert far.kind == "throw"
    assert far.cost() > found[0].cost()


@pytest.mark.slow
def test_one_module_carries_comes_down_and_throws(tmp_path: Path) -> None:
    text = HALL.replace("kind: limms", "kind: limms\nrobot: limms_quick")
    text = text.replace("goal: [0.7, 0.1, 0.4]", "goal: [0.4, 0.1, 1.42], arrival_speed: 1.5")
    path = tmp_path / "high.yaml"
    path.write_text(text, encoding="utf-8")
    plan = plan_limms(load_limms(path))
    assert verify_plan(plan).passed
    modes = plan.motion.box_mode[:, 0]
    changes = modes[np.flatnonzero(np.diff(modes, prepend=0))]
    assert list(changes) == [1, 3, 1, 3, 2]  # held, put down, held, thrown
