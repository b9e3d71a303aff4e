"""Motion files as the published loaders use them: by key and position, poses put into MuJoCo.

HybridRobotics/whole_body_tracking and mujocolab/mjlab read seven keys, select bodies by index along
the second axis, and put the root's pose, its velocity and the joints into their simulators.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from climbplan.climb.exports.tracked_motion import read_tracked_motion
from climbplan.motions.motion_file import write_motion_file

URDF = Path(__file__).parents[2] / "specs" / "walker.urdf"
ROOT = 0  # index of the root among the bodies
KEYS = ("joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w")


@pytest.fixture(scope="module")
def arrays(urdf_climb: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, NDArray[Any]]:
    """All arrays of the file of a climb by a robot from a URDF."""
    path = tmp_path_factory.mktemp("loaded") / "climb.npz"
    write_motion_file(read_tracked_motion(urdf_climb, 50.0), path)
    with np.load(path) as stored:  # as the loaders do: no pickles are allowed by default
        return {key: stored[key] for key in stored.files}


@pytest.fixture(scope="module")
def simulator() -> tuple[Any, Any]:
    """MuJoCo and its model of the robot, free to move."""
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False
    spec.worldbody.first_body().add_freejoint()
    return mujoco, spec.compile()


def test_the_seven_keys_have_the_documented_shapes(arrays: dict[str, NDArray[Any]]) -> None:
    assert int(arrays["fps"][0]) == 50
    samples, joints = arrays["joint_pos"].shape
    bodies = len(arrays["body_names"])
    assert joints == len(arrays["joint_names"])
    assert arrays["joint_vel"].shape == (samples, joints)
    for key in KEYS:
        assert arrays[key].dtype == np.float32
        assert np.isfinite(arrays[key]).all()
        if key.startswith("body_"):
            width = 4 if "quat" in key else 3
            assert arrays[key].shape == (samples, bodies, width)
            assert arrays[key][:, [0, bodies - 1]].shape == (samples, 2, width)


def test_bodies_and_joints_are_in_the_order_of_mujoco(
    arrays: dict[str, NDArray[Any]], simulator: tuple[Any, Any]
) -> None:
    _, model = simulator
    names = [model.body(k).name for k in range(1, model.nbody)]
    assert arrays["body_names"].tolist() == names
    joints = [model.joint(k).name for k in range(1, model.njnt)]
    assert arrays["joint_names"].tolist() == joints


def test_poses_and_velocities_are_those_of_the_simulator(
    arrays: dict[str, NDArray[Any]], simulator: tuple[Any, Any]
) -> None:
    """Quaternions are w, x, y, z; velocities are of the links' frames, in the world frame."""
    mujoco, model = simulator
    state = mujoco.MjData(model)
    velocity = np.zeros(6)
    fastest = np.abs(arrays["joint_vel"]).max(axis=1).argsort()[-3:]
    for sample in (0, *fastest.tolist(), len(arrays["joint_pos"]) - 1):
        quaternion = arrays["body_quat_w"][sample, ROOT].astype(float)
        state.qpos[:3] = arrays["body_pos_w"][sample, ROOT]
        state.qpos[3:7] = quaternion
        state.qpos[7:] = arrays["joint_pos"][sample]
        state.qvel[:3] = arrays["body_lin_vel_w"][sample, ROOT]
        turn = arrays["body_ang_vel_w"][sample, ROOT].astype(float)
        mujoco.mju_rotVecQuat(state.qvel[3:6], turn, quaternion * [1, -1, -1, -1])
        state.qvel[6:] = arrays["joint_vel"][sample]
        mujoco.mj_forward(model, state)
        np.testing.assert_allclose(state.xpos[1:], arrays["body_pos_w"][sample], atol=1e-5)
        alignment = np.abs((state.xquat[1:] * arrays["body_quat_w"][sample]).sum(axis=1))
        np.testing.assert_allclose(alignment, 1.0, atol=1e-6)
        for body in range(1, model.nbody):
            mujoco.mj_objectVelocity(model, state, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
            expected = np.concatenate(
                [
                    arrays["body_ang_vel_w"][sample, body - 1],
                    arrays["body_lin_vel_w"][sample, body - 1],
                ]
            )
            np.testing.assert_allclose(velocity, expected, atol=2e-4)
    assert np.abs(arrays["joint_vel"]).max() > 0.01
