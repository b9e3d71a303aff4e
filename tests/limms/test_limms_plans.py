"""Plans: verified as planned, and every lie in them found."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from climbplan.errors import PlanFileError
from climbplan.limms.check.verification import verify_and_mark, verify_plan
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan


def failing(plan: LimmsPlan) -> set[str]:
    return {check.name for check in verify_plan(plan).failed}


def tampered(plan: LimmsPlan, **arrays: Any) -> LimmsPlan:
    return replace(plan, motion=replace(plan.motion, **arrays))


def test_throw_is_verified_and_flies(throw: LimmsPlan, throw_file: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(throw_file, tmp_path / "plan.h5"))
    assert verify_and_mark(path).passed
    again = read_limms_plan(path)
    assert again.verified
    assert np.array_equal(again.motion.joint_angles, throw.motion.joint_angles)
    assert again.sequence == throw.sequence
    modes = throw.motion.box_mode[:, 0]
    assert set(modes) == {1, 2, 3}  # stable, manipulated, then free
    flown = throw.motion.time[modes == 2]
    assert flown[-1] - flown[0] > 0.1
    # The goal is above what the arm reaches: shoulder, and wrist beside the box
    shoulder = throw.motion.anchor_position[0, 4] + np.array([0.124, 0, 0])
    wrist = throw.goal[0] - np.array([0.1 + 0.124, 0, 0])
    assert np.linalg.norm(wrist - shoulder) > 0.33 + 0.078 + 0.33


def test_forces_and_motion_that_disagree_are_found(throw: LimmsPlan) -> None:
    force = throw.motion.force.copy()
    held = throw.motion.box_mode[:, 0] == 3
    force[held, 0, 1] += 1e-3
    assert failing(tampered(throw, force=force)) == {"box.dynamics"}
    assert "force.limit" in failing(tampered(throw, force=3 * throw.motion.force))
    free = throw.motion.force.copy()
    free[throw.motion.box_mode[:, 0] == 2, 0, 1, 2] = 1.0
    assert {"force.without_contact", "box.dynamics"} <= failing(tampered(throw, force=free))


def test_modes_that_break_the_rules_are_found(throw: LimmsPlan) -> None:
    mode = throw.motion.mode.copy()
    mode[mode == 2] = 1
    # An arm that calls itself free: rules 5, 6 and 8, and no end on the ground
    names = {"logic.rule_5", "logic.rule_6", "logic.rule_8", "ground.support"}
    assert names <= failing(tampered(throw, mode=mode))
    box_mode = throw.motion.box_mode.copy()
    box_mode[box_mode == 3] = 4
    assert {"logic.rule_1", "logic.rule_3"} <= failing(tampered(throw, box_mode=box_mode))
    held = throw.motion.tip_anchor.copy()
    held[:] = -1
    assert "logic.rule_7" in failing(tampered(throw, tip_anchor=held))


def test_joints_and_places_that_are_off_are_found(throw: LimmsPlan) -> None:
    angles = throw.motion.joint_angles.copy()
    angles[200] += 1e-3
    assert "kinematics.forward" in failing(tampered(throw, joint_angles=angles))
    slow = {**throw.module, "max_joint_speed": 2.0}
    assert "speed.limit" in failing(replace(throw, module=slow))
    stiff = {**throw.module, "joint_range": [0.2] * 6}
    assert "kinematics.joint_bounds" in failing(replace(throw, module=stiff))
    weak = {**throw.module, "latch_moment": 0.1}
    assert "latch.moment" in failing(replace(throw, module=weak))
    long = {**throw.module, "latch_dwell": 60.0}
    assert "latch.dwell" in failing(replace(throw, module=long))
    far = throw.goal.copy()
    far[0, 2] += 0.01
    assert {"goal.position", "file.spec_values"} <= failing(replace(throw, goal=far))


def test_collisions_are_found(throw: LimmsPlan) -> None:
    # A block right where the arm swings, and one in the way of the box
    points = throw.motion.joint_position[300, 0, 3]
    arm = np.array([[points - 0.02, points + 0.02]])
    assert "limbs.collision" in failing(replace(throw, solids=np.concatenate([throw.solids, arm])))
    way = throw.motion.box_position[-5, 0]
    block = np.array([[way - 0.02, way + 0.02]])
    assert "box.collision" in failing(replace(throw, solids=np.concatenate([throw.solids, block])))
    thick = {**throw.module, "radius": 0.2}
    assert "limbs.self_collision" in failing(replace(throw, module=thick))


def test_arrival_and_samples(throw: LimmsPlan) -> None:
    assert "goal.speed" in failing(replace(throw, arrival_speed=0.5))
    time = throw.motion.time.copy()
    time[100:] += 0.05
    assert "trajectory.rate" in failing(tampered(throw, time=time))
    velocity = throw.motion.box_velocity.copy()
    velocity[-20:] += 0.01
    assert "box.kinematics" in failing(tampered(throw, box_velocity=velocity))


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    path.write_bytes(b"not HDF5")
    with pytest.raises(PlanFileError):
        read_limms_plan(path)
