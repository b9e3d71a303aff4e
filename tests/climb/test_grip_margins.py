"""Margins of grips: further pull that they hold, and friction that holds may lack."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.arrays import spans_of
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.forces.grips.plan import find_firm_limbs
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import load_climb

WALL = Path(__file__).parents[2] / "specs" / "climb_single_wall.yaml"


def planned(*overrides: str) -> ClimbPlan:
    return plan_climb(load_climb(WALL, list(overrides)))


def held(plan: ClimbPlan) -> float:
    """The least further pull that a grip in contact holds [N]."""
    assert plan.grips is not None
    return float(plan.grips.pull_margin[plan.instants.contact].min())


@pytest.fixture(scope="module")
def bare() -> ClimbPlan:
    """Fingers that grip half as hard as the shipped ones, and ask for no more than they need."""
    return planned("gripper.max_force=40", "margins=none")


def test_grips_hold_their_margin_at_no_cost_of_torque(bare: ClimbPlan) -> None:
    plan = planned("gripper.max_force=40")
    weight = plan.robot.weight
    assert held(bare) < 0.06 * weight
    assert held(plan) > 0.0999 * weight
    assert plan.forces.safety_torque.min() == pytest.approx(bare.forces.safety_torque.min(), 1e-3)
    verification = verify_plan(plan)
    assert verification.passed
    assert verification.fragile == ()
    names = {check.name for check in verification.checks}
    assert {"robust.pull", "robust.slip"} <= names
    assert not {"robust.normal_force", "robust.depth"} & names
    assert not any(check.name.startswith("robust.") for check in verify_plan(bare).checks)


def test_fingers_grip_all_the_time_with_the_most_that_a_stance_asks_for(bare: ClimbPlan) -> None:
    assert bare.grips is not None
    contact, grip = bare.trajectory.contact, bare.grips.trajectory.grip
    at_instants = bare.grips.instants.grip.max(axis=0)
    for limb in range(contact.shape[1]):
        for first, after in spans_of(contact[:, limb]):
            assert np.ptp(grip[first:after, limb]) == 0.0
            assert 0.0 < grip[first, limb] <= 40.0
        assert grip[:, limb].max() >= at_instants[limb] - 1e-9
        assert not grip[~contact[:, limb], limb].any()


def test_fingers_grip_no_harder_than_they_must_on_steep_sides() -> None:
    loaded = load_climb(WALL)
    scene = build_scene(loaded.spec, loaded.robot)
    assert scene.grippers is not None
    instants = planned().instants
    steep = np.full_like(scene.grippers.undercut, np.arctan(0.9) - 1e-3)
    steep[instants.region[-1, 0]] += 2e-3
    may = find_firm_limbs(replace(scene.grippers, undercut=steep), instants)
    assert may.tolist() == [False, True, True, True]


def test_a_plan_that_holds_less_than_its_spec_asks_for_is_fragile(bare: ClimbPlan) -> None:
    asked = planned("gripper.max_force=40")
    swapped = replace(bare, spec_text=asked.spec_text, spec_sha256=asked.spec_sha256)
    words = verify_plan(swapped).fragile
    assert any("pull-out reserve" in told and "margin 8.6 N" in told for told in words)


def test_margins_that_cannot_be_had_are_shared_and_the_remedy_works() -> None:
    asked = ("margins.slip=0.4", "gripper.max_force=")
    plan = planned(asked[0], asked[1] + "40")
    assert plan.forces.margin_share is not None
    assert 0.5 < plan.forces.margin_share.min() < 1.0
    (note,) = plan.forces.notes
    assert note.startswith("fragile: 3 of 40 instants, round 4, LH lifted keeps 88% of its margins")
    assert "gripping force >= 42 N a finger" in note
    assert "S_mu" not in note
    verification = verify_plan(plan)
    assert verification.passed
    assert any(
        "loss of friction before it slides" in told and "margin 40 %" in told
        for told in verification.fragile
    )
    mended = planned(asked[0], asked[1] + "42")
    assert mended.forces.notes == ()
    assert verify_plan(mended).fragile == ()


def test_open_grippers_are_asked_for_no_pull() -> None:
    """Upside down they hold nothing; standing on the panel they only press."""
    plan = planned(
        "gripper.max_force=0",
        "terrain.panel.angle_deg=0",
        "task.start={com: [0, 0, 0.3595], rpy_deg: [0, 0, 0]}",
        "task.goal={com: [0, 0.375, 0.3595], tolerance: 0.03}",
    )
    assert plan.forces.notes == ()
    assert plan.grips is not None
    np.testing.assert_allclose(plan.grips.instants.grip, 0.0, atol=1e-9)
    assert verify_plan(plan).fragile == ()
