"""Quadrupeds: what is planned holds at every millisecond, and what cannot be is not claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from limms_scenes import loaded, scene
from scipy.optimize import linprog

from climbplan.errors import Infeasible, LimitReached
from climbplan.limms.check.verification import verify
from climbplan.limms.legs.leaps import find_leaps
from climbplan.limms.legs.standing import compute_max_load_fraction
from climbplan.limms.plan.file import write_limms_plan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.limms.task_planning.single_actions import find_single_actions


@pytest.mark.slow
def test_leap_down_from_a_platform_verifies(tmp_path: Path) -> None:
    plan = plan_limms(loaded("limms_jump"))
    assert plan.sequence == "quadruped"
    write_limms_plan(plan, tmp_path / "plan.h5")
    assert verify(tmp_path / "plan.h5").passed
    motion = plan.motion
    flying = (motion.box_mode[:, 0] == 4) & (motion.ground_end < 0).all(axis=1)
    # In the air for a tenth of a second at least, on the ground's parabola
    assert np.diff(motion.time)[flying[1:] & flying[:-1]].sum() > 0.1
    assert np.allclose(motion.box_acceleration[flying, 0], [0, 0, -GRAVITY], atol=1e-6)


def test_heavy_box_is_lifted_by_legs_and_a_light_one_by_arms() -> None:
    heavy, light = (
        find_single_actions(scene("limms_lift_heavy", f"box.mass={m}")) for m in (7, 0.5)
    )
    assert [s.kind for s in heavy.actions] == ["quadruped"]
    assert light.actions[0].kind == "arms"
    with pytest.raises(Infeasible, match=r"28\.7 N short"):
        plan_limms(loaded("limms_lift_heavy", "task.allow=[arms]"))


@pytest.mark.slow
def test_quadruped_over_a_ledge_verifies(tmp_path: Path) -> None:
    plan = plan_limms(loaded("limms_lift_heavy"))
    write_limms_plan(plan, tmp_path / "plan.h5")
    assert verify(tmp_path / "plan.h5").passed
    carried = plan.motion.box_mode[:, 0] == 4
    assert np.linalg.norm(plan.motion.force[carried, 0], axis=-1).max() > 17  # close to its limit


def test_load_of_four_feet_is_the_least_there_is() -> None:
    rng = np.random.default_rng(0)
    round_box = np.array([[0.6, 0, 0], [-0.6, 0, 0], [0, 0.6, 0], [0, -0.6, 0]])
    feet = round_box + rng.uniform(-0.5, 0.5, (20, 4, 3))
    shares = compute_max_load_fraction(feet, np.zeros(3))
    for four, share in zip(feet, shares, strict=True):
        rows = np.vstack([np.ones(4), four[:, 0], four[:, 1]])
        best = linprog(
            [0, 0, 0, 0, 1],
            A_ub=np.column_stack([np.eye(4), -np.ones(4)]),
            b_ub=np.zeros(4),
            A_eq=np.column_stack([rows, np.zeros(3)]),
            b_eq=[1, 0, 0],
        )
        assert share == pytest.approx(best.fun if best.success else np.inf, abs=1e-6)


def test_time_limit_covers_the_whole_planning() -> None:
    with pytest.raises(LimitReached, match=r"within 2 s\..*quadruped"):
        plan_limms(loaded("limms_walk", "solver.time_limit=2"))


@pytest.mark.slow
def test_walk_verifies(tmp_path: Path) -> None:
    plan = plan_limms(loaded("limms_walk"))
    write_limms_plan(plan, tmp_path / "plan.h5")
    assert verify(tmp_path / "plan.h5").passed


def test_leaps_do_what_they_say() -> None:
    jump = scene("limms_jump")
    leaps = find_leaps(jump, jump.goal, np.random.default_rng(3))
    assert leaps
    for leap in leaps:
        t = leap.duration
        end = leap.takeoff + leap.speed * t - np.array([0, 0, GRAVITY * t**2 / 2])
        assert np.allclose(end, leap.landing, atol=1e-9)
        assert jump.patches[leap.patches[0]].contains(leap.before, 0.03).all()
        assert jump.patches[leap.patches[1]].contains(leap.after, 0.03).all()
        turned = np.abs(leap.angles[:, 1] - leap.angles[:, 0]).max()
        assert turned <= jump.module.max_joint_speed * t


def test_published_joint_speed_is_too_slow_for_this_leap() -> None:
    slow = scene("limms_jump", "robot=limms")
    assert find_leaps(slow, slow.goal, np.random.default_rng(0)) == []
