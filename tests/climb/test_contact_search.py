"""Footholds one after the other: over stairs and stones, and what is said where there are none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import climbplan
from climbplan.cli.app import run
from climbplan.climb.contact_search.footholds import BodyPose, FootholdFinder
from climbplan.climb.contact_search.guide_path import build_guide_path
from climbplan.climb.contact_search.suitability import find_obstacle_to_method
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_text
from climbplan.errors import LimitReached, NoPlanFound, SpecError, UsageError

STANCE = """\
  stance:
    RF: [0.256, 0.445, -0.24]
    RM: [0.514, 0.000, -0.24]
    RR: [0.256, -0.445, -0.24]
    LR: [-0.256, -0.445, -0.24]
    LM: [-0.514, 0.000, -0.24]
    LF: [-0.256, 0.445, -0.24]
"""
# Treads 0.31 m long, each 50 mm above the one before
STAIRS = f"""\
kind: climb
robot: silvia
terrain:
  friction: 0.8
  regions:
    - {{name: floor, rectangle: {{center: [0, -0.26, 0], normal: [0, 0, 1], width: 1.6, height: 1.48}}}}
    - {{name: first, rectangle: {{center: [0, 0.675, 0.05], normal: [0, 0, 1], width: 1.6, height: 0.31}}}}
    - {{name: second, rectangle: {{center: [0, 1.43, 0.10], normal: [0, 0, 1], width: 1.6, height: 1.12}}}}
task:
  rounds: auto
  start: {{com: [0, 0, 0.24]}}
  goal: {{com: [0, 1.2, 0.34]}}
{STANCE}posture: {{rotation_limit_deg: 12}}
"""  # noqa: E501
GAP = STAIRS.replace("center: [0, 1.43, 0.10]", "center: [0, 2.43, 0.10]").replace(
    "com: [0, 1.2, 0.34]", "com: [0, 2.2, 0.34]"
)


def scene_of(text: str) -> ClimbScene:
    loaded = load_text(text, "spec")
    return build_scene(loaded.spec, loaded.robot)


def test_the_guide_path_makes_a_ramp_of_stairs() -> None:
    scene = scene_of(STAIRS)
    guide = build_guide_path(scene)
    heights = np.array([guide.interpolate(d)[0][2] for d in np.linspace(0, guide.length, 60)])
    assert (np.diff(heights) > -1e-9).all()
    np.testing.assert_allclose(guide.interpolate(0.0)[0], scene.start.com)
    np.testing.assert_allclose(guide.interpolate(guide.length)[0], scene.goal.com, atol=1e-9)
    np.testing.assert_allclose(guide.interpolate(0.0)[1], 0.0, atol=1e-9)
    middle = guide.interpolate(guide.length / 2)[1]
    assert np.deg2rad(2) < middle[0] < np.deg2rad(12), "the nose points up the stairs"
    partly = build_guide_path(scene, 0.5).interpolate(guide.length / 2)[1]
    np.testing.assert_allclose(partly, 0.5 * middle, atol=1e-12)
    assert guide.steepest >= middle[0]
    assert abs(middle[1]) < 1e-9


def test_a_ramp_to_the_side_rolls_the_body() -> None:
    slope = np.deg2rad(8)
    ramp = STAIRS[: STAIRS.index("  regions:")] + (
        "  regions:\n    - {name: ramp, rectangle: {center: [0, 0, 0], "
        f"normal: [{-np.sin(slope):.9f}, 0, {np.cos(slope):.9f}], width: 6, height: 6}}}}\n"
    )
    scene = scene_of(ramp + STAIRS[STAIRS.index("task:") :].replace("0.34", "0.24"))
    guide = build_guide_path(scene)
    angles = guide.interpolate(guide.length / 2)[1]
    # Ground that rises to the right lifts the right side: a turn about -y
    assert angles[1] == pytest.approx(-slope, abs=1e-6)
    assert abs(angles[0]) < 1e-6


def test_footholds_are_in_their_regions_and_the_nearest_comes_first() -> None:
    scene = scene_of(STAIRS)
    finder = FootholdFinder(scene)
    guide = build_guide_path(scene)
    limb = scene.robot.limb_names.index("RF")
    nominal = guide.place_nominal_toe(0.1, scene.robot.stance_body[limb])
    poses = [BodyPose(*guide.interpolate(d)) for d in (0.0, 0.05, 0.1)]
    footholds = finder.find(limb, scene.start.toes[limb], nominal, poses)
    assert len(footholds) > 3
    for foothold in footholds:
        assert scene.standing[foothold.region].distance(foothold.point) < 1e-9
    level = [float(np.linalg.norm((f.point - nominal)[:2])) for f in footholds]
    assert level[0] == min(level)
    near = finder.find(limb, scene.start.toes[limb], nominal, poses, max_distance=0.01)
    assert all(np.linalg.norm(f.point - nominal) <= 0.01 for f in near)


def test_stairs_are_climbed_and_verified() -> None:
    plan = climbplan.plan(STAIRS)
    verification = plan.verify()
    assert verification.passed, verification.headline()
    assert "contact search" in str(plan.solvers["posture"])
    assert {0, 1, 2} <= set(np.unique(plan["rounds/region"]))
    again = climbplan.plan(STAIRS, method="contact-search")
    np.testing.assert_array_equal(plan["rounds/toes"], again["rounds/toes"])
    # The goal's toes are those it chose
    goal = yaml.safe_load(str(again.spec))["task"]["goal"]["toes"]
    np.testing.assert_allclose([*goal.values()], plan["rounds/toes"][-1], atol=1e-12)


def test_a_gap_ends_the_search_and_the_message_says_where() -> None:
    with pytest.raises(
        NoPlanFound, match=r"footholds for 0\.\d+ of 2\.\d+ m, in \d+ rounds; the"
    ) as info:
        climbplan.plan(GAP, method="contact-search", time_limit=40)
    assert not isinstance(info.value, LimitReached)
    assert "no foothold within its reach" in str(info.value)
    part = info.value.partial
    assert isinstance(part, climbplan.Plan)
    assert part.status == "partial"
    assert part.verify().passed
    assert 0.3 < part["rounds/com"][-1][1] < 1.3
    assert "partial: 0." in part.warnings[0]


def test_a_command_leaves_the_part_that_it_planned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gap.yaml").write_text(GAP, encoding="utf-8")
    command = ["plan-climb", "gap.yaml", "--method", "contact-search", "--json", "--no-report"]
    assert run(command) == 4
    printed = json.loads(capsys.readouterr().out)
    assert printed["partial"] == "outputs/gap/partial.h5"
    assert [path.name for path in Path("outputs/gap").iterdir()] == ["partial.h5"]
    # A part is in nobody's way
    Path("gap.yaml").write_text(STAIRS, encoding="utf-8")
    assert run(command) == 0
    assert {path.name for path in Path("outputs/gap").iterdir()} == {"plan.h5", "report.json"}


def test_a_limit_of_work_says_how_far_the_search_came() -> None:
    with pytest.raises(LimitReached, match="ended by the time limit"):
        climbplan.plan(STAIRS, method="contact-search", time_limit=0.01)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("task.rounds", 3, "as many rounds as are needed: write `task.rounds: auto`"),
        ("posture.steps.toe_min", 0.01, "has no smallest step; expected 0"),
    ],
)
def test_what_it_cannot_state_is_refused(key: str, value: float, message: str) -> None:
    with pytest.raises((SpecError, UsageError), match=message):
        climbplan.plan(STAIRS, {key: value}, method="contact-search")
    if key != "task.rounds":
        loaded = load_text(STAIRS, "spec", [f"{key}={value}"])
        assert find_obstacle_to_method(build_scene(loaded.spec, loaded.robot)) is not None
