"""Why there are no postures: start, goal, distance, and the closest sequence's violations."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from climbplan.climb.postures.planner import plan_postures
from climbplan.climb.scene import ClimbScene
from climbplan.errors import Infeasible

SceneMaker = Callable[..., ClimbScene]


def reasons(scene: ClimbScene) -> str:
    with pytest.raises(Infeasible) as caught:
        plan_postures(scene)
    assert caught.value.exit_code == 3
    return str(caught.value)


def free_goal(demo_climb: SceneMaker, **values: Any) -> ClimbScene:
    return demo_climb(**{"task.goal.toes": {}, "task.goal.com": (0.0, 0.0, 0.3), **values})


def test_distance_says_how_many_rounds_are_needed(demo_climb: SceneMaker) -> None:
    scene = free_goal(demo_climb, **{"task.goal.com": (0.0, 0.0, 0.6)})
    text = reasons(scene)  # 3 rounds of at most 150 mm; 580 mm beside the tolerance
    assert "the body's way to the goal, 0.580 m in steps of at most 150 mm" in text
    assert "rounds >= 4" in text


def test_a_goal_beyond_reach_names_the_limb(demo_climb: SceneMaker) -> None:
    text = reasons(free_goal(demo_climb, **{"task.goal.com": (0.2, 0.0, 0.3)}))
    assert "goal posture: L" in text
    assert "cannot reach its toe (too far by" in text


def test_an_impossible_start_is_named(demo_climb: SceneMaker) -> None:
    text = reasons(free_goal(demo_climb, **{"task.start.com": (0.2, 0.0, 0.0)}))
    assert "start posture: L" in text


def test_violations_of_the_closest_sequence(demo_climb: SceneMaker) -> None:
    """A goal pose that no free region holds: the body would have to be in the obstacle."""
    beam = {"name": "beam", "lower": (-0.6, -0.6, 0.2), "upper": (0.6, 0.6, 0.5)}
    text = reasons(free_goal(demo_climb, **{"terrain.obstacles": [beam]}))
    assert "the closest one found still has" in text
    # Either the body is in the beam, or it stays below and misses the goal by what the beam takes.
    said = re.search(r"body (\d+) mm (into an obstacle|further from the goal)", text)
    assert said
    assert int(said[1]) > 100


def test_what_is_feasible_is_not_explained_away(demo_climb: SceneMaker) -> None:
    assert plan_postures(free_goal(demo_climb)).status == "optimal"
