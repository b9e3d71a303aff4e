"""Links beside boxes that limbs stand upon: thick, but for the last stretch of the tibia."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.check.verification import verification_of, verify
from climbplan.climb.limb_clearance import NARROW, closest_link, narrowed
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.climb.transition.planner import plan_transition
from climbplan.climb.transition.scene import build_transition
from climbplan.robots.capsules import straight_capsules
from climbplan.spec.climb.transition_loading import load_transition
from climbplan.terrain.solids import Solid

BRICKS = Path(__file__).parents[3] / "specs" / "transition_bricks.yaml"


def test_who_may_stand_on_what() -> None:
    scene = build_transition(load_transition(BRICKS))
    names = scene.robot.limb_names
    expected = np.zeros((6, 2), bool)
    expected[names.index("LF"), 0] = expected[names.index("LR"), 1] = True
    np.testing.assert_array_equal(scene.terrain.stood_upon, expected)


def test_nobody_stands_on_a_plain_obstacle_or_beside_its_faces() -> None:
    beam = "terrain.obstacles=[{name: beam, lower: [-0.1, 0.3, 0.6], upper: [0.1, 0.4, 0.7]}]"
    for where, stands in ((0.7, True), (0.71, False)):
        top = (
            f"terrain.regions=[{{name: top, vertices: [[-0.1, 0.3, {where}], [0.1, 0.3, {where}], "
            f"[0.1, 0.4, {where}], [-0.1, 0.4, {where}]]}}]"
        )
        loaded = load_transition(
            BRICKS.parent / "transition_flat.yaml", [beam] + ([top] if where else [])
        )
        scene = build_transition(loaded)
        assert scene.terrain.stood_upon.all() == stands
        assert scene.terrain.stood_upon.any() == stands


def test_a_tibia_narrows_to_its_toe_only_where_it_stands() -> None:
    box = Solid.from_box("box", np.zeros(3), np.ones(3))
    limb = np.array([[[2.0, 0.5, 1.5], [1.5, 0.5, 1.5], [0.5, 0.5, 1.4], [0.5, 0.5, 1.0]]])
    axes = straight_capsules(limb, 0.0)
    assert closest_link((box,), axes, 0.5, np.array([[False]])).distance == pytest.approx(0.0)
    found = closest_link((box,), axes, 0.5, np.array([[True]]))
    assert found.distance == pytest.approx(NARROW)
    assert found.link == 2
    # Deeper than that a link that stands is as much in the way as any other.
    low = limb - [0.0, 0.0, 0.3]
    assert closest_link((box,), straight_capsules(low, 0.0), 0.5, np.array([[True]])).distance < 0
    thick = closest_link((box,), straight_capsules(limb, 0.02), 0.5, np.array([[True]]))
    assert thick.distance == pytest.approx(NARROW - 0.02)
    short = np.array([[0.0, 0, 0.3], [0.1, 0, 0.3], [0.2, 0, 0.01], [0.2, 0, 0.0]])
    ends = narrowed(straight_capsules(short[None], 0.02))[0]
    np.testing.assert_array_equal(ends[:2], short[1:3])
    assert np.isnan(ends[2]).all()  # a tibia shorter than its narrow part has no other


@pytest.fixture(scope="module")
def plan() -> ClimbPlan:
    return plan_transition(load_transition(BRICKS))


def test_the_verifier_lets_stand_only_who_may(plan: ClimbPlan, tmp_path: Path) -> None:
    write_climb(plan, tmp_path / "plan.h5")
    passed = {check.name: check for check in verify(tmp_path / "plan.h5").checks}
    assert passed["limbs.capsules"].passed
    assert passed["trajectory.capsules"].passed
    assert "brick" in passed["limbs.capsules"].worst_at
    terrain = replace(plan.terrain, allowed=plan.terrain.allowed & False)
    failed = {c.name for c in verification_of(replace(plan, terrain=terrain)).failed}
    assert {"limbs.capsules", "trajectory.capsules", "contact.allowed"} <= failed


def test_thicker_links_hit_the_bricks(plan: ClimbPlan) -> None:
    robot = replace(plan.robot, limb_radius=0.045)
    failed = {c.name for c in verification_of(replace(plan, robot=robot)).failed}
    assert "limbs.capsules" in failed or "trajectory.capsules" in failed
