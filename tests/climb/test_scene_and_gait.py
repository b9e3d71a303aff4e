"""From a spec to start and goal postures, and from postures to the critical instants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import ReachFailure, SpecError
from climbplan.robots.kinematics import toe_world
from climbplan.schema.robots.source import load_robot

BASE = """
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [-1.0, 2.0]}
task:
  rounds: 2
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.2]}
"""


def scene_with(change: Callable[[dict[str, Any]], None] = lambda data: None) -> ClimbScene:
    from pathlib import Path

    data = yaml.safe_load(BASE)
    change(data)
    return build_scene(ClimbSpec.model_validate(data), load_robot("silvia", Path.cwd()))


def straight(scene: ClimbScene) -> Rounds:
    share = np.linspace(0, 1, scene.spec.task.rounds + 1)
    start, goal = scene.start, scene.goal
    return Rounds(
        com=start.com + share[:, None] * (goal.com - start.com),
        rpy=start.rpy + share[:, None] * (goal.rpy - start.rpy),
        toes=start.toes + share[:, None, None] * (goal.toes - start.toes),
        region=np.tile(start.region, (len(share), 1)),
    )


def test_toes_stand_on_their_own_wall() -> None:
    scene = scene_with()
    names = scene.robot.limb_names
    for limb, name in enumerate(names):
        side = -0.615 if name.startswith("L") else 0.615
        assert scene.start.toes[limb, 0] == pytest.approx(side)
        surface = scene.terrain.surfaces[scene.start.region[limb]]
        assert surface.name == ("left" if name.startswith("L") else "right")
        assert surface.normal_at(scene.start.toes[limb])[0] * side < 0


def test_stated_toes_must_be_on_a_surface() -> None:
    def change(data: dict[str, Any]) -> None:
        data["task"]["start"]["toes"] = {"LF": [-0.6, 0.3, 0.0], "RF": [0.615, 0.3, 0.0]}

    with pytest.raises(SpecError, match=r"task\.start\.toes\.LF.*15\.00 mm off 'left'"):
        scene_with(change)


def test_stance_of_the_task_replaces_the_robots() -> None:
    scene = scene_with(lambda d: d["task"].update(stance={"LF": [-0.6, 0.25, -0.05]}))
    lf = scene.robot.limb_names.index("LF")
    np.testing.assert_allclose(scene.start.toes[lf], [-0.615, 0.25, -0.05])


def test_every_limb_is_lifted_once_a_round_in_gait_order() -> None:
    order = ["LM", "RF", "RM", "LR", "RR", "LF"]
    scene = scene_with(lambda d: d["task"].update(gait=order))
    instants = plan_instants(scene, straight(scene))
    assert instants.count == 24
    lifted = instants.lifted
    assert (lifted.sum(axis=1) == np.tile([1, 0], 12)).all()
    names = [scene.robot.limb_names[i] for i in np.argmax(lifted[::2], axis=1)]
    assert names == order * 2
    assert (instants.contact == ~lifted).all()
    assert instants.label(0, scene.robot.limb_names) == "round 1, LM lifted"
    assert instants.label(13, scene.robot.limb_names) == "round 2, push 1"


def test_toes_change_only_when_lifted_and_end_on_the_next_posture() -> None:
    scene = scene_with()
    rounds = straight(scene)
    instants = plan_instants(scene, rounds)
    before = rounds.toes[0]
    for k in range(0, instants.count, 2):
        limb = int(np.argmax(instants.lifted[k]))
        others = np.arange(6) != limb
        np.testing.assert_allclose(instants.toes[k][others], before[others])
        hover = instants.toes[k, limb] - before[limb]
        np.testing.assert_allclose(hover, 0.05 * instants.normal[k, limb], atol=1e-12)
        np.testing.assert_allclose(instants.toes[k + 1][others], before[others])
        before = instants.toes[k + 1]
    np.testing.assert_allclose(before, rounds.toes[-1])
    np.testing.assert_allclose(instants.com[-1], rounds.com[-1])
    # The body covers a sixth of its way with every push and stands still during a lift.
    np.testing.assert_allclose(np.diff(instants.com[:13:2, 2]), 0.1 / 6)


def test_joint_angles_reach_the_toes() -> None:
    scene = scene_with()
    instants = plan_instants(scene, straight(scene))
    toes = toe_world(scene.robot, instants.com, instants.rpy, instants.joint_angles)
    np.testing.assert_allclose(toes, instants.toes, atol=1e-12)


def test_reach_failure_names_round_and_limb() -> None:
    scene = scene_with()
    rounds = straight(scene)
    com = rounds.com.copy()
    com[2, 0] += 0.2  # too far from the left wall in round 2
    with pytest.raises(ReachFailure, match=r"round 2, .*: L[FRM] cannot reach its toe: too far"):
        plan_instants(scene, replace(rounds, com=com))


def test_payload_and_wind_act_about_the_body_origin() -> None:
    def change(data: dict[str, Any]) -> None:
        data["task"]["payload"] = {"mass": 2.0, "offset": [0.1, 0.0, 0.05]}
        data["task"]["external_wrench"] = {"force": [3.0, 0, 0], "moment": [0, 0, 0.5]}

    scene = scene_with(change)
    instants = plan_instants(scene, straight(scene))
    weight = 2.0 * 9.81
    np.testing.assert_allclose(instants.external_wrench[0], [3, 0, -weight, 0, 0.1 * weight, 0.5])
