"""Motors that are at their limits at instants keep within them between these, too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.motion.in_hand import plan_with_torque_reserve
from climbplan.climb.motion.trajectory import TimedMotion
from climbplan.climb.plan.climb_plan import ClimbPlan, InstantForces
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_climb

if TYPE_CHECKING:
    from climbplan.climb.motion.keyframes import Keyframes

SPEC = Path(__file__).parents[2] / "specs" / "climb_walker.yaml"
SHORT = [
    "task.rounds=1",
    "task.goal.com=[0,0,0.12]",
    "margins.normal_force=0",
    "margins.friction=0",
]


@pytest.fixture(scope="module", name="plan")
def _plan() -> ClimbPlan:
    return plan_climb(load_climb(SPEC, SHORT))


def played_with(
    monkeypatch: pytest.MonkeyPatch, plan: ClimbPlan, uses: list[float]
) -> tuple[InstantForces, list[float]]:
    """The forces that are chosen where motions have these uses in turn, and S_tau asked for."""
    asked: list[float] = []

    def fake(scene: ClimbScene, *_: object) -> TimedMotion:
        asked.append(scene.spec.force.safety_torque)
        return TimedMotion(
            replace(plan.trajectory, time=plan.trajectory.time + len(asked)),
            uses.pop(0),
            cast("Keyframes", None),  # which motions without a pace do not need
        )

    monkeypatch.setattr("climbplan.climb.motion.in_hand.build_timed_motion", fake)
    loaded = load_climb(SPEC, SHORT)
    scene = build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)
    forces, motion = plan_with_torque_reserve(scene, plan.rounds, plan.instants, plan.forces)
    assert motion.time[0] == (1 if forces is plan.forces else len(asked))
    return forces, asked


def test_motors_that_lack_nothing_change_nothing(
    plan: ClimbPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    forces, asked = played_with(monkeypatch, plan, [1.0])
    assert forces is plan.forces
    assert asked == [1.0]


def test_forces_have_in_hand_what_the_motion_lacks(
    plan: ClimbPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    forces, asked = played_with(monkeypatch, plan, [1.2, 1.1, 0.99])
    assert forces is not plan.forces
    assert asked == pytest.approx([1.0, 1.01 * 1.2, 1.01**2 * 1.2 * 1.1])
    assert forces.safety_torque.min() >= asked[-1]


def test_what_cannot_be_had_stays_as_it_was(
    plan: ClimbPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    most = float(plan.forces.safety_torque.min())
    forces, asked = played_with(monkeypatch, plan, [5.0 * most])
    assert forces is plan.forces
    assert asked == [1.0]
    forces, _ = played_with(monkeypatch, plan, [1.1, 1.2, 1.2, 1.2])  # no better
    assert forces is plan.forces


def test_a_plan_that_is_short_nowhere_is_as_it_was(plan: ClimbPlan) -> None:
    found = verify_plan(plan)
    assert found.passed
    (torque,) = (check for check in found.checks if check.name == "trajectory.torque")
    assert torque.used < 1
