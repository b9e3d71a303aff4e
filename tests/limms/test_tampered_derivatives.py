"""Stored derivatives and labels that do not belong to the stored positions fail verification."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from climbplan.limms.check.checker import _compute_rate_errors
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.plan.limms_plan import LimmsPlan


@pytest.mark.parametrize(
    ("field", "change", "place", "check"),
    [
        ("joint_velocity", 2.0, 0.4, "kinematics.joint_velocity"),
        ("joint_velocity", -0.5, 0.0, "kinematics.joint_velocity"),
        ("box_yaw_acceleration", 0.01, 1.0, "box.kinematics"),
        ("ground_end", 0.0, 0.4, "trajectory.continuity"),
    ],
)
def test_one_changed_entry_is_noticed(
    field: str, change: float, place: float, check: str, throw: LimmsPlan
) -> None:
    motion = throw.motion
    values = vars(motion)[field].copy()
    sample = round(place * (len(values) - 1))
    values[sample].flat[-1] += change
    if field == "ground_end":
        values[sample] = np.where(motion.ground_end[sample] == 0, 1, 0)
    found = verify_plan(replace(throw, motion=replace(motion, **{field: values})))
    assert check in {one.name for one in found.failed}


def test_rates_of_smooth_motions_pass_at_any_spacing() -> None:
    time = np.cumsum(np.random.default_rng(2).uniform(1e-3, 0.01, 200))
    phase = np.array([1.0, 4.0, 9.0])[None, None] * time[:, None, None]
    angles, rates = np.sin(phase), np.cos(phase) * np.array([1.0, 4.0, 9.0])
    assert _compute_rate_errors(time, angles, rates).max() < 0.02
    for short in (2, 3):
        assert _compute_rate_errors(time[:short], angles[:short], rates[:short]).max() < 0.02
    rates[100, 0, 2] += 0.5
    assert _compute_rate_errors(time, angles, rates).max() > 0.2
