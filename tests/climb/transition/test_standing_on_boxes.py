"""Links beside boxes that limbs stand upon: thick, but for the last stretch of the tibia."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.check.verification import verify, verify_plan
from climbplan.climb.clearance.limbs import (
    INTERPOLATION_MARGIN,
    compute_link_distances,
    taper_links,
)
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.planner import plan_transition
from climbplan.climb.transition.scene import build_transition
from climbplan.robots.capsules import straight_capsules
from climbplan.terrain.raw_surface import NARROW, SLENDER
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


UPRIGHT = np.array([[[2.0, 0.5, 1.5], [1.5, 0.5, 1.5], [0.5, 0.5, 1.4], [0.5, 0.5, 1.0]]])


def room_on_a_box(limb: Array, radius: float, foot: float = 0.0) -> float:
    """Of links with joints and toe (1, 4, 3) that may stand on a box of which z = 1 is the top."""
    box = Solid.from_box("box", np.zeros(3), np.ones(3))
    links = taper_links(straight_capsules(limb, radius), foot)
    return float(np.nanmin(compute_link_distances(box, links.starts, links.ends) - links.radius))


def test_a_tibia_narrows_to_its_toe_where_it_stands() -> None:
    at_narrow = SLENDER * NARROW - INTERPOLATION_MARGIN
    assert room_on_a_box(UPRIGHT, 0.005) == pytest.approx(NARROW - 0.005)
    assert room_on_a_box(UPRIGHT, 0.02) == pytest.approx(NARROW - at_narrow)
    # Deeper than that a link that stands is as much in the way as any other
    assert room_on_a_box(UPRIGHT - [0.0, 0.0, 0.3], 0.02) < 0


@pytest.mark.parametrize(("degrees", "kept"), [(12.0, False), (18.0, True)])
def test_a_tibia_that_lies_along_what_it_stands_on_is_too_near(degrees: float, kept: bool) -> None:
    slope, toe = np.deg2rad(degrees), UPRIGHT[0, -1]
    leaning = UPRIGHT.copy()
    leaning[0, 2] = toe + 0.4 * np.array([np.cos(slope), 0.0, np.sin(slope)])
    leaning[0, :2] = leaning[0, 2] + [[0.5, 0.0, 0.5], [0.2, 0.0, 0.5]]
    assert (room_on_a_box(leaning, 0.025) >= INTERPOLATION_MARGIN) == kept


def test_a_spherical_foot_has_the_room_of_its_radius() -> None:
    lifted = UPRIGHT + np.array([0.0, 0.0, 0.02])  # toes are centres of feet
    assert room_on_a_box(lifted, 0.01, 0.02) == pytest.approx(0.01)
    # A thicker link is a cone about the foot
    assert room_on_a_box(lifted, 0.03, 0.02) == pytest.approx(INTERPOLATION_MARGIN)


@pytest.fixture(scope="module")
def plan() -> ClimbPlan:
    return plan_transition(load_transition(BRICKS))


def test_the_verifier_lets_stand_only_who_may(plan: ClimbPlan, tmp_path: Path) -> None:
    write_climb(plan, tmp_path / "plan.h5")
    passed = {check.name: check for check in verify(tmp_path / "plan.h5").checks}
    assert passed["limbs.collision"].passed
    assert passed["trajectory.collision"].passed
    terrain = replace(plan.terrain, allowed=plan.terrain.allowed & False)
    failed = {c.name for c in verify_plan(replace(plan, terrain=terrain)).failed}
    assert {"limbs.collision", "trajectory.collision", "contact.allowed"} <= failed


def test_thicker_links_hit_what_is_beside_them(plan: ClimbPlan) -> None:
    robot = replace(plan.robot, limb_radius=0.1)
    failed = {c.name for c in verify_plan(replace(plan, robot=robot)).failed}
    assert "limbs.collision" in failed or "trajectory.collision" in failed
