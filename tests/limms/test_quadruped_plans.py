"""Quadrupeds: what is planned holds at every millisecond, and what cannot be is not claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from limms_scenes import loaded, scene

from climbplan.limms.leaps import find_leaps
from climbplan.limms.plan_file import write_limms_plan
from climbplan.limms.planner import plan_limms
from climbplan.limms.scene import GRAVITY
from climbplan.limms.verification import verify


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


def test_leaps_do_what_they_say() -> None:
    jump = scene("limms_jump")
    leaps = find_leaps(jump, jump.goal, np.random.default_rng(3))
    assert leaps
    for leap in leaps:
        t = leap.duration
        end = leap.takeoff + leap.speed * t - np.array([0, 0, GRAVITY * t**2 / 2])
        assert np.allclose(end, leap.landing, atol=1e-9)
        assert jump.patches[leap.patches[0]].inside(leap.before, 0.03).all()
        assert jump.patches[leap.patches[1]].inside(leap.after, 0.03).all()
        turned = np.abs(leap.angles[:, 1] - leap.angles[:, 0]).max()
        assert turned <= jump.module.max_joint_speed * t


def test_published_joint_speed_is_too_slow_for_this_leap() -> None:
    slow = scene("limms_jump", "robot=limms")
    assert find_leaps(slow, slow.goal, np.random.default_rng(0)) == []
