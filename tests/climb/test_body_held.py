"""What no toes can hold: a body before an edge, against the lever; what they can is not refused."""

from __future__ import annotations

import time

import numpy as np
import pytest

from climbplan.climb.planner.proof import prove_infeasibility
from climbplan.climb.planner.static_feasibility import build_pyramid_edges, find_unsupported_places
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_text

REACH = 0.224 + 0.057 + 0.195 + 0.375  # [m] from the body's middle, links stretched out
TOLERANCE = 0.02


def before_an_edge(beyond: float, friction: float = 0.8, extra: str = "") -> ClimbScene:
    """A goal that far beyond the edge of level ground, over which nothing is to stand on."""
    text = f"""\
kind: climb
robot: silvia
terrain:
  friction: {friction}
  ground: {{across: [-3, 3], along: [-3, 0]}}
task:
  rounds: 6
  start: {{com: [0, -0.6, 0.24]}}
  goal: {{com: [0, {beyond}, 0.24], tolerance: {TOLERANCE}}}
{extra}"""
    loaded = load_text(text, "edge")
    return build_scene(loaded.spec, loaded.robot)


@pytest.mark.parametrize("beyond", [0.1, 0.3])
def test_the_pull_is_that_of_the_lever(beyond: float) -> None:
    scene = before_an_edge(beyond)
    (found,) = find_unsupported_places(scene)
    assert found.place == "goal posture"
    # Pressed at the edge, pulled where a toe reaches furthest back, the goal missed by all it may
    over = beyond - TOLERANCE
    back = REACH + TOLERANCE - beyond
    assert found.min_pull == pytest.approx(scene.robot.weight * over / back, rel=2e-2)
    proof = prove_infeasibility(scene, time.monotonic() + 10)
    assert proof is not None
    assert f"a pull of {found.min_pull:.0f} N towards surfaces is missing" in str(proof)


@pytest.mark.parametrize("beyond", [-0.3, 0.0, 0.015])
def test_a_body_over_ground_within_its_tolerance_is_not_refused(beyond: float) -> None:
    assert find_unsupported_places(before_an_edge(beyond)) == []


def test_a_wall_before_the_edge_holds_it() -> None:
    loaded = load_text(
        """\
kind: climb
robot: silvia
terrain:
  friction: 0.8
  ground: {across: [-3, 3], along: [-3, 0]}
  regions:
    - {name: wall, rectangle: {center: [0, 0.7, 0], normal: [0, -1, 0], width: 2, height: 2}}
task:
  rounds: 6
  start: {com: [0, -0.6, 0.24]}
  goal: {com: [0, 0.3, 0.24]}
""",
        "wall",
    )
    assert find_unsupported_places(build_scene(loaded.spec, loaded.robot)) == []


def test_a_load_that_may_turn_with_the_body_is_not_judged() -> None:
    extra = "  payload: {mass: 1, offset: [0, 0.1, 0]}\n"
    assert find_unsupported_places(before_an_edge(0.3, extra=extra)) == []


def test_pyramids_contain_their_cones() -> None:
    region = before_an_edge(0.0).terrain.regions[0]
    edges = build_pyramid_edges(region, 0.8, 16)
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 50)
    rays = region.normal + 0.8 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    # Each face of the pyramid has all rays of the cone on its inner side
    for first, second in zip(edges, np.roll(edges, -1, axis=0), strict=True):
        face = np.cross(first, second)
        face *= np.sign(face @ region.normal)
        assert (rays @ face >= -1e-12).all()
