"""Inverse kinematics with the last link's rotation, on chains of six joints."""

from __future__ import annotations

import numpy as np

from climbplan.robots.chain_pose import ChainZero
from climbplan.robots.pose_inverse import pose_inverse

LEG = ChainZero(  # hip yaw, roll, pitch, knee, ankle pitch, roll; x right, y forward, z up
    joints=np.array(
        [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, -0.4], [0, 0, -0.8], [0, 0, -0.8]], float
    ),
    axes=np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]], float),
    toe=np.array([0, 0.03, -0.88]),
)
POSTURE = np.array([0.0, 0.0, 0.4, -0.8, 0.4, 0.0])


def test_angles_come_back() -> None:
    rng = np.random.default_rng(1)
    count = 200
    angles = POSTURE + rng.uniform(-0.3, 0.3, (count, 6))
    chain = (
        LEG.rows(np.zeros(count, int))
        if LEG.joints.ndim == 3
        else ChainZero(
            *(np.repeat(v[None], count, axis=0) for v in (LEG.joints, LEG.axes, LEG.toe))
        )
    )
    pose = chain.pose(angles)
    wide = np.full((count, 6), 2.0)
    home = np.repeat(POSTURE[None], count, axis=0)
    found = pose_inverse(chain, home, pose.toe, pose.turns[:, -1], -wide, wide)
    assert found.reached.all(), found.missing[~found.reached]
    again = chain.pose(found.angles)
    np.testing.assert_allclose(again.toe, pose.toe, atol=1e-9)
    np.testing.assert_allclose(again.turns[:, -1], pose.turns[:, -1], atol=1e-8)
    np.testing.assert_allclose(found.angles, angles, atol=1e-6)


def test_what_is_out_of_reach_is_told() -> None:
    chain = ChainZero(*(v[None] for v in (LEG.joints, LEG.axes, LEG.toe)))
    bounds = np.full((1, 6), 2.0)
    found = pose_inverse(
        chain, POSTURE[None], np.array([[0.0, 0.0, -1.5]]), np.eye(3)[None], -bounds, bounds
    )
    assert not found.reached.any()
    assert found.missing[0].max() > 0.1
