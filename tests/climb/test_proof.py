""" "No plan exists" is said only where what the spec states proves it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from climbplan.climb.planner.proof import prove_infeasibility
from climbplan.climb.postures.outer_relaxation import bound_shoulders, build_outer_program
from climbplan.climb.postures.planner import plan_postures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Infeasible
from climbplan.instances.straight_climb import interpolate_rounds
from climbplan.robots.rotations import rotation_world_body

SceneMaker = Callable[..., ClimbScene]
FREE: dict[str, Any] = {"task.goal.toes": {}, "task.goal.com": (0.0, 0.0, 0.3)}


def proof(scene: ClimbScene) -> Infeasible | None:
    return prove_infeasibility(scene, time.monotonic() + 60.0)


def test_what_has_a_plan_is_not_proved_away(demo_climb: SceneMaker) -> None:
    assert proof(demo_climb()) is None
    assert proof(demo_climb(**FREE)) is None
    steps = {"com_max": 0.15, "toe_max": 0.24, "rotation_max_deg": 10.0}
    assert proof(demo_climb(**{"posture.steps": steps, "posture.rotation_limit_deg": 20.0})) is None


@pytest.mark.parametrize("given", [True, False], ids=["stated", "default"])
def test_steps_count_only_if_the_spec_states_them(demo_climb: SceneMaker, given: bool) -> None:
    far = {**FREE, "task.goal.com": (0.0, 0.0, 0.6)}  # 0.58 m in 3 steps of 0.15 m, the default
    if given:
        far["posture.steps"] = {"com_max": 0.15}
    found = proof(demo_climb(**far))
    assert (found is not None) == given
    if found is not None:
        assert found.exit_code == 3
        assert "0.580 m in steps of at most 150 mm, takes 4 rounds at least" in str(found)
        assert "; at least needed: rounds >= 4 (--set task.rounds=4) or steps" in str(found)
        remedies = {r.key: r.value for r in found.remedies}
        assert remedies == {"task.rounds": 4, "posture.steps.com_max": 0.194}


def test_remedies_for_steps_are_enough(demo_climb: SceneMaker) -> None:
    far = {**FREE, "task.goal.com": (0.0, 0.0, 0.6), "posture.steps": {"com_max": 0.15}}
    assert proof(demo_climb(**{**far, "task.rounds": 4})) is None
    assert proof(demo_climb(**{**far, "posture.steps": {"com_max": 0.194}})) is None


def test_toes_beyond_the_length_of_a_limb(demo_climb: SceneMaker) -> None:
    near, far = (
        {"terrain.walls": {"gap": gap, "along": (-0.8, 0.8), "up": (-1.0, 2.0)},
         "task.start.toes": {}, **FREE}
        for gap in (1.45, 1.75)
    )  # fmt: skip
    # Middle legs reach 0.224 + 0.627 m from the body's middle, front legs less
    assert proof(demo_climb(**near)) is None
    found = proof(demo_climb(**far))
    assert found is not None
    assert "start posture: RM cannot reach any place where it may stand (24.0 mm too far" in str(
        found
    )


@pytest.mark.parametrize(("friction", "proved"), [(0.30, True), (0.40, False)])
def test_friction_cones_that_cannot_carry(
    demo_climb: SceneMaker, friction: float, proved: bool
) -> None:
    """Walls that lean away from each other by 20 degrees: without friction it slides down."""
    lean = np.deg2rad(20.0)
    walls = []
    for name, side, limbs in (
        ("left", -1.0, ["LF", "LM", "LR"]),
        ("right", 1.0, ["RF", "RM", "RR"]),
    ):
        normal = [-side * np.cos(lean), 0.0, -np.sin(lean)]
        centre = [side * 0.615, 0.0, 0.0]
        walls.append(
            {
                "name": name,
                "rectangle": {"center": centre, "normal": normal, "width": 2.0, "height": 3.0},
                "limbs": limbs,
            }
        )
    values = {"terrain.regions": walls, "terrain.friction": friction, "task.start.toes": {}, **FREE}
    values["terrain.walls"] = None
    found = proof(demo_climb(**values))  # tan 20 deg = 0.364
    assert (found is not None) == proved
    if found is not None:
        assert "no forces within the friction cones of 'left', 'right' carry the robot" in str(
            found
        )
        assert found.remedies[0].key == "terrain.friction"
        assert proof(demo_climb(**{**values, "terrain.friction": found.remedies[0].value})) is None


def test_a_safety_factor_counts_only_if_stated(demo_climb: SceneMaker) -> None:
    lean = {"terrain.friction": 0.5}  # upright walls: any friction carries
    assert proof(demo_climb(**lean)) is None
    assert proof(demo_climb(**{**lean, "force": {"safety_friction": 40.0}})) is None


def test_a_goal_inside_an_obstacle(demo_climb: SceneMaker) -> None:
    block = {"name": "block", "lower": (-0.1, -0.1, 0.2), "upper": (0.1, 0.1, 0.4)}
    found = proof(demo_climb(**{**FREE, "terrain.obstacles": [block]}))
    assert found is not None
    assert "the body's middle is 100 mm inside 'block'" in str(found)
    beside = {**FREE, "task.goal.com": (0.0, 0.2, 0.3)}  # the hull overlaps, the origin does not
    assert proof(demo_climb(**{**beside, "terrain.obstacles": [block]})) is None


def test_every_plan_satisfies_the_outer_statement(demo_climb: SceneMaker) -> None:
    values: dict[str, Any] = {
        **FREE,
        "task.goal.rpy_deg": (0.0, 5.0, 8.0),
        "posture.steps": {"com_max": 0.15, "toe_max": 0.24},
        "posture.rotation_limit_deg": 20.0,
    }
    scene = demo_climb(**values)
    for rounds in (plan_postures(scene).rounds, interpolate_rounds(scene)):
        program = build_outer_program(scene)
        point = program.point({"toe": rounds.toes[1:], "com": rounds.com[1:]})
        report = program.check(point)
        assert report.worst().residual <= 1e-9, report.worst()


def test_balls_hold_the_shoulders_at_every_rotation(demo_climb: SceneMaker) -> None:
    rng = np.random.default_rng(3)
    scene = demo_climb(**{"posture.rotation_limit_deg": 25.0})
    limit = np.deg2rad(25.0)
    turns = rotation_world_body(rng.uniform(-limit, limit, (2000, 3)))
    shoulders = np.einsum("kij,nj->kni", turns, scene.robot.shoulder_body)
    balls = bound_shoulders(scene)
    assert len(balls) == 2
    for centre, radius in balls:
        assert (np.linalg.norm(shoulders - centre, axis=-1) <= radius + 1e-12).all()
