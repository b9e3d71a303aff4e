"""Kinematics of a module against itself: forward of inverse, from either end."""

from __future__ import annotations

import numpy as np
import pytest
from limms_scenes import loaded

from climbplan.limms.modules.chain import (
    BRANCHES,
    forward,
    forward_from_last,
    solve_inverse_kinematics,
)
from climbplan.limms.scene.limms_scene import FramePoses

MODULE = loaded("limms_lift_light").module


def poses(count: int) -> tuple[FramePoses, np.ndarray]:
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1, 1, (count, 6)) * np.array([3, 2, 2.6, 3, 2, 3])
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    turn *= np.linalg.det(turn)[:, None, None]
    return FramePoses(rng.normal(size=(count, 3)), turn), angles


def test_every_branch_reaches_the_pose_and_one_is_the_start() -> None:
    base, angles = poses(200)
    own = forward(MODULE, base, angles)
    last = FramePoses(own.position[:, 7], own.rotation[:, 7])
    nearest = np.full(200, np.inf)
    for branch in BRANCHES:
        found = solve_inverse_kinematics(MODULE, base, last, branch)
        assert found.reach_error.max() < 1e-9
        again = forward(MODULE, base, found.angles)
        assert np.abs(again.position[:, 7] - last.position).max() < 1e-9
        assert np.abs(again.rotation[:, 7] - last.rotation).max() < 1e-9
        off = np.abs((found.angles - angles + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
        nearest = np.minimum(nearest, off)
    assert nearest.max() < 1e-7


def test_points_from_the_last_end_are_those_from_the_first() -> None:
    base, angles = poses(20)
    own = forward(MODULE, base, angles)
    back = forward_from_last(MODULE, FramePoses(own.position[:, 7], own.rotation[:, 7]), angles)
    assert np.abs(back.position - own.position).max() < 1e-12
    lengths = np.linalg.norm(np.diff(own.position, axis=1), axis=2)
    assert lengths == pytest.approx(np.tile(MODULE.link_lengths, (20, 1)))


def test_out_of_reach_says_by_how_much() -> None:
    base = FramePoses(np.zeros(3), np.eye(3))
    last = FramePoses(np.array([0, 0, sum(MODULE.link_lengths) + 0.1]), np.eye(3))
    assert solve_inverse_kinematics(MODULE, base, last, BRANCHES[0]).reach_error == pytest.approx(
        0.1
    )
