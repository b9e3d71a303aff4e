"""Lengths in millimetres or centimetres are refused by their keys, before anything is planned."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import load_climb, load_text
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.scene import build_transition
from climbplan.errors import SpecError

SPECS = Path(__file__).parents[2] / "specs"
WALLS = """
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-800, 800], up: [-800, 1400]}
task:
  rounds: 1
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.05]}
"""


def refused(*overrides: str) -> str:
    loaded = load_text(WALLS, "walls", list(overrides))
    with pytest.raises(SpecError) as caught:
        build_scene(loaded.spec, loaded.robot)
    (mistake,) = caught.value.mistakes
    return f"{mistake.key}: {mistake.message}"


@pytest.mark.parametrize("gap", [1150.0, 115.0])
def test_walls_out_of_all_proportion_are_a_mistake(gap: float) -> None:
    text = refused(f"terrain.walls.gap={gap}")
    assert text.startswith("terrain.walls.gap: expected a gap that SiLVIA spans")
    assert f"got {gap:g} m" in text
    assert f"{gap:g} mm are {1e-3 * gap:g}" in text


def test_a_goal_far_from_every_surface_is_a_mistake() -> None:
    text = refused("task.goal.com=[0, 0, 5000]")
    assert text.startswith("task.goal.com: expected a distance from the nearest contact surface")


def test_a_payload_far_beyond_the_motors_is_a_mistake() -> None:
    text = refused("task.payload.mass=2000")
    assert text.startswith("task.payload.mass: expected a payload that the motors of SiLVIA hold")
    assert "got 2000 kg" in text
    assert "2000 g are 2" in text
    # Too heavy to be planned with, but not absurd: planning says why not
    loaded = load_text(WALLS, "walls", ["task.payload.mass=100"])
    assert build_scene(loaded.spec, loaded.robot).terrain.surfaces


def test_walls_that_are_merely_too_far_apart_are_not() -> None:
    loaded = load_text(WALLS, "walls", ["terrain.walls.gap=5"])
    assert build_scene(loaded.spec, loaded.robot).terrain.surfaces


def test_tubes_and_transitions_are_looked_at_too() -> None:
    tube = load_climb(SPECS / "climb_tube.yaml", ["terrain.tube.radius=600"])
    with pytest.raises(SpecError, match=r"terrain\.tube\.radius"):
        build_scene(tube.spec, tube.robot)
    with pytest.raises(SpecError, match=r"terrain\.walls\.gap"):
        build_transition(
            load_transition(SPECS / "transition_flat.yaml", ["terrain.walls.gap=1230"])
        )
