"""Why the convex method has no postures: start, goal, distance, closed ways, violations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.postures.planner import plan_postures
from climbplan.climb.scene.climb_scene import ClimbScene

SceneMaker = Callable[..., ClimbScene]


def refused(scene: ClimbScene, because: str = "method micp has rotations") -> NoPostures:
    with pytest.raises(NoPostures) as caught:
        plan_postures(scene)
    assert caught.value.exit_code == 4
    assert f"not proved: {because}" in str(caught.value)
    return caught.value


def free_goal(demo_climb: SceneMaker, **values: Any) -> ClimbScene:
    return demo_climb(**{"task.goal.toes": {}, "task.goal.com": (0.0, 0.0, 0.3), **values})


def test_distance_says_how_many_rounds_are_needed(demo_climb: SceneMaker) -> None:
    scene = free_goal(demo_climb, **{"task.goal.com": (0.0, 0.0, 0.6)})
    error = refused(
        scene, "steps (`posture.steps`)"
    )  # 3 rounds of at most 150 mm; 580 mm beside the tolerance
    text = "the body's way to the goal, 0.580 m in steps of at most 150 mm, takes 4 rounds at least"
    assert text in str(error)
    changes = {r.key: r.value for r in error.changes}
    assert changes == {"task.rounds": 4, "posture.steps.com_max": 0.194}


def test_a_goal_beyond_reach_names_the_limb(demo_climb: SceneMaker) -> None:
    text = str(refused(free_goal(demo_climb, **{"task.goal.com": (0.2, 0.0, 0.3)})))
    assert "goal posture: L" in text
    assert "cannot reach its toe (too far by" in text


def test_an_impossible_start_is_named(demo_climb: SceneMaker) -> None:
    text = str(refused(free_goal(demo_climb, **{"task.start.com": (0.2, 0.0, 0.0)})))
    assert "start posture: L" in text


def test_a_goal_in_an_obstacle_says_where_there_is_room(demo_climb: SceneMaker) -> None:
    beam = {"name": "beam", "lower": (-0.6, -0.6, 0.2), "upper": (0.6, 0.6, 0.5)}
    error = refused(free_goal(demo_climb, **{"terrain.obstacles": [beam]}))
    assert "goal posture: the body, level, lacks 170 mm of the room beside 'beam'" in str(error)
    (change,) = error.changes
    assert change.option == "--set 'task.goal.com=[0, 0, 0.12]'"


@pytest.mark.parametrize("clearance", [0.02, 0.08])
def test_a_closed_way_says_by_how_much(demo_climb: SceneMaker, clearance: float) -> None:
    """Two plates across the shaft leave a slit of 300 mm to a body of 260 mm."""
    plates = [
        {"name": "left plate", "lower": (-2.0, -2.0, 0.14), "upper": (-0.15, 2.0, 0.16)},
        {"name": "right plate", "lower": (0.15, -2.0, 0.14), "upper": (2.0, 2.0, 0.16)},
    ]
    values = {"terrain.obstacles": plates, "posture.body_clearance": clearance}
    if clearance <= 0.02:
        with pytest.raises(NoPostures) as caught:
            plan_postures(free_goal(demo_climb, **values))
        assert "the way is closed" not in str(caught.value)
        return
    error = refused(free_goal(demo_climb, **values))
    assert "the way is closed: at 'left plate' and 'right plate'" in str(error)
    assert "lacks 120 mm between what is on both sides of it, or 60 mm on one" in str(error)
    assert [(r.key, r.value) for r in error.changes] == [("posture.body_clearance", 0.02)]


def test_violations_name_obstacle_and_side(demo_climb: SceneMaker) -> None:
    post = {"name": "post", "lower": (0.3, -0.3, 0.1), "upper": (0.34, 0.3, 0.25)}
    text = str(refused(free_goal(demo_climb, **{"terrain.obstacles": [post]})))
    assert "violations of the closest one:" in text
    assert "of 'post' (face " in text or "below 'post' (face " in text or "above 'post'" in text


def test_what_is_feasible_is_not_explained_away(demo_climb: SceneMaker) -> None:
    assert plan_postures(free_goal(demo_climb)).status == "optimal"
