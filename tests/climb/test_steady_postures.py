"""Postures planned nearer to the stance where a braced body would buckle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from climbplan.climb.check.verification import verify
from climbplan.climb.forces.explanation import NoForces
from climbplan.climb.motion.motion import StageClock, plan_motion, plan_support
from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import LoadedClimb, load_text
from climbplan.schema.examples import read_example

_LITTLE_STABILITY = (
    "task.gait=[RF, RM, RR, LR, LM, LF]",
    "posture.weights.toe=0.01",
    "force.min_stiffness_ratio=0.02",
    "force.min_normal_force=0",
)


def _climb(*overrides: str) -> LoadedClimb:
    return load_text(
        read_example("climb_obstacle"), "climb_obstacle", (*_LITTLE_STABILITY, *overrides)
    )


def _scene(*overrides: str) -> ClimbScene:
    loaded = _climb(*overrides)
    return build_scene(loaded.spec, loaded.robot, loaded.source)


@pytest.mark.slow
def test_a_body_that_would_buckle_is_held_nearer_to_the_stance(tmp_path: Path) -> None:
    plan = plan_climb(_climb("task.rounds=10"))
    assert any("stance workspaces tightened" in note for note in plan.notes)
    write_climb(plan, tmp_path / "plan.h5")
    assert verify(tmp_path / "plan.h5").passed
    # The bound is still that of the statement, with the whole workspaces.
    alone = plan_motion(_scene("task.rounds=10"), _clock())
    assert plan.bound == pytest.approx(alone.posture.bound)
    assert plan.bound is not None
    assert plan.bound < plan.objective


def test_only_stability_moves_the_postures() -> None:
    """Friction alone does not: the error of the first motion, without another attempt."""
    scene = _scene("force.safety_friction=3.2")
    clock = _clock()
    motion = plan_motion(scene, clock)
    planned = clock.seconds["posture"]
    with pytest.raises(NoForces) as caught:
        plan_support(scene, motion, clock)
    assert not caught.value.is_unstable
    assert clock.seconds["posture"] == planned


def test_the_published_workspaces_are_left_as_they_are() -> None:
    """Without a stance workspace there is nothing to tighten."""
    scene = _scene("task.rounds=10")
    motion = plan_motion(scene, _clock())
    posture = scene.spec.posture.model_copy(update={"stance_workspace": False})
    scene = replace(scene, spec=scene.spec.model_copy(update={"posture": posture}))
    with pytest.raises(NoForces, match="stability") as caught:
        plan_support(scene, motion, _clock())
    assert caught.value.is_unstable


def _clock() -> StageClock:
    return StageClock(lambda stage, fraction: None)
