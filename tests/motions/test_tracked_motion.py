"""Motions for tracking pipelines: the published layout, exact contacts, velocities, forces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenes import PlannedScenes
from scipy.spatial.transform import Rotation

from climbplan.api.kinds import identify_kind
from climbplan.arrays import Array, spans_of
from climbplan.climb.exports.motion import read_motion
from climbplan.climb.exports.tracked_motion import read_tracked_motion
from climbplan.climb.plan.file import read_climb
from climbplan.errors import UsageError
from climbplan.motions.contact_rule import compute_contact_points
from climbplan.motions.link_tree import build_joint_fill, build_link_tree
from climbplan.motions.measure import measure_slip
from climbplan.motions.motion_file import name_terrain_file, read_motion_file
from climbplan.motions.tracked_motion import TrackedMotion
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.robots.urdf.tree import read_urdf

SPECS = Path(__file__).parents[2] / "specs"
# What the loaders of HybridRobotics/whole_body_tracking and mujocolab/mjlab read, and its axes
PUBLISHED = {
    "joint_pos": "TJ",
    "joint_vel": "TJ",
    "body_pos_w": "TB3",
    "body_quat_w": "TB4",
    "body_lin_vel_w": "TB3",
    "body_ang_vel_w": "TB3",
}


def compute_slip(motion: TrackedMotion) -> float:
    contacts = motion.contacts
    assert contacts is not None
    points = compute_contact_points(motion, contacts)
    touching = np.broadcast_to(contacts.is_touching[..., None], points.shape[:-1])
    return float(measure_slip(points, touching).max())


def test_the_file_has_the_published_layout(motion: TrackedMotion, motion_file: Path) -> None:
    sizes = {
        "T": len(motion.time),
        "J": len(motion.joint_names),
        "B": len(motion.body_names),
        "3": 3,
        "4": 4,
    }
    with np.load(motion_file, allow_pickle=False) as arrays:
        assert arrays["fps"].shape == (1,)
        assert arrays["fps"].dtype == np.int64
        for key, axes in PUBLISHED.items():
            assert arrays[key].dtype == np.float32, key
            assert arrays[key].shape == tuple(sizes[axis] for axis in axes), key
        assert arrays["contact"].dtype == bool
        assert arrays["contact"].shape == (sizes["T"], 6)
        for key in ("contact_force", "contact_position", "contact_normal"):
            assert arrays[key].shape == (sizes["T"], 6, 3)
        assert arrays["joint_torque"].shape == arrays["joint_pos"].shape
        assert arrays["joint_names"].tolist()[:3] == ["RF_coxa", "RF_femur", "RF_tibia"]
        assert arrays["body_names"].tolist()[:2] == ["body", "RF_coxa"]
        assert json.loads(str(arrays["facts"]))["robot"] == "SiLVIA"
    assert name_terrain_file(motion_file).is_file()


def test_quaternions_are_w_x_y_z_of_the_body(climb: Path, motion_file: Path) -> None:
    plan = read_climb(climb)
    with np.load(motion_file) as arrays:
        quaternion = arrays["body_quat_w"][:, 0].astype(float)
    first = Rotation.from_quat(quaternion[0, [1, 2, 3, 0]]).as_matrix()
    assert first == pytest.approx(rotation_world_body(plan.trajectory.rpy[0]), abs=1e-6)
    assert np.linalg.norm(quaternion, axis=-1) == pytest.approx(1, abs=1e-6)
    assert ((quaternion[1:] * quaternion[:-1]).sum(axis=1) > 0).all()


@pytest.mark.parametrize("rate", [7.0, 33.3, 120.0])
def test_stance_toes_stand_still_at_odd_rates(climb: Path, rate: float) -> None:
    motion = read_tracked_motion(climb, rate)
    assert motion.fps == rate
    assert compute_slip(motion) < 1e-9
    assert motion.contacts is not None
    lifted = ~motion.contacts.is_touching
    assert lifted.any(axis=0).all()
    assert (lifted.sum(axis=1) <= 1).all()


def test_stance_toes_of_a_urdf_stand_still(urdf_climb: Path) -> None:
    motion = read_tracked_motion(urdf_climb, 47.0)
    assert compute_slip(motion) < 1e-9
    assert motion.body_names[0] == "base_link"
    assert "L1_knee" in motion.joint_names


def test_positions_at_the_samples_of_the_plan_are_those_of_the_plan(climb: Path) -> None:
    plan, planned = read_climb(climb), read_motion(climb)
    step = plan.trajectory.time[1] - plan.trajectory.time[0]
    motion = read_tracked_motion(climb, 1 / step)
    assert motion.body_position[:, 0] == pytest.approx(plan.trajectory.com, abs=1e-9)
    assert planned.joints is not None
    assert motion.joint_position == pytest.approx(planned.joints.link_angle, abs=1e-7)
    assert motion.contacts is not None
    assert planned.contacts is not None
    assert motion.contacts.force == pytest.approx(planned.contacts.force, abs=1e-9)
    assert motion.joint_torque == pytest.approx(
        planned.joints.torque + planned.joints.gravity, abs=1e-9
    )


def test_velocities_are_derivatives_of_positions(climb: Path) -> None:
    """Differences at a high rate, and the same velocities at any rate."""
    motion = read_tracked_motion(climb, 1000.0)
    span = 2 / motion.fps

    def largest(stored: Array, differences: Array) -> float:
        return float(np.abs(stored[1:-1] - differences).max())

    assert (
        largest(
            motion.joint_velocity, (motion.joint_position[2:] - motion.joint_position[:-2]) / span
        )
        < 2e-2  # [rad/s]
    )
    assert (
        largest(motion.body_velocity, (motion.body_position[2:] - motion.body_position[:-2]) / span)
        < 1e-2  # [m/s]
    )
    rotation = motion.body_rotation
    turn = rotation[2:] @ np.swapaxes(rotation[:-2], -1, -2)
    angular = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec()
    assert largest(motion.body_angular_velocity, angular.reshape(turn.shape[:-1]) / span) < 5e-2
    slower = read_tracked_motion(climb, 100.0)
    assert slower.body_velocity == pytest.approx(motion.body_velocity[::10], abs=1e-12)


def test_forces_balance_the_weight_and_vanish_in_the_air(
    climb: Path, motion: TrackedMotion
) -> None:
    plan = read_climb(climb)
    contacts = motion.contacts
    assert contacts is not None
    assert contacts.force is not None
    total = contacts.force.sum(axis=1)
    assert total == pytest.approx(
        np.broadcast_to([0, 0, plan.robot.weight], total.shape), abs=1e-3 * plan.robot.weight
    )
    assert not contacts.force[~contacts.is_touching].any()
    assert (contacts.surface[~contacts.is_touching] == -1).all()
    assert (contacts.surface[contacts.is_touching] >= 0).all()


def test_the_file_is_read_as_it_was_written(motion: TrackedMotion, motion_file: Path) -> None:
    stored = read_motion_file(motion_file)
    for name in ("joint_position", "body_position", "body_quaternion", "joint_torque"):
        assert getattr(stored, name) == pytest.approx(getattr(motion, name), abs=1e-5), name
    assert stored.joint_names == motion.joint_names
    assert stored.body_names == motion.body_names
    assert stored.contacts is not None
    assert motion.contacts is not None
    assert stored.contacts.names == motion.contacts.names
    assert (stored.contacts.is_touching == motion.contacts.is_touching).all()
    assert spans_of(stored.contacts.is_touching[:, 0]) == spans_of(
        motion.contacts.is_touching[:, 0]
    )
    assert stored.terrain is not None
    assert motion.terrain is not None
    assert stored.terrain.corners == pytest.approx(motion.terrain.corners, abs=1e-6)


@pytest.mark.parametrize("name", ["walker", "telescope", "biped"])
def test_links_are_where_pinocchio_has_them(name: str) -> None:
    pin = pytest.importorskip("pinocchio")
    path = SPECS / f"{name}.urdf"
    urdf = read_urdf(path)
    tree = build_link_tree(urdf)
    model = pin.buildModelFromXML(path.read_text(encoding="utf-8"), pin.JointModelFreeFlyer())
    data = model.createData()
    rng = np.random.default_rng(3)
    values = rng.uniform(-0.3, 0.3, (4, len(tree.joint_names)))
    values = build_joint_fill(urdf, tree).fill_positions(tree.joint_names, values)
    position = rng.normal(size=(4, 3))
    rotation = Rotation.random(4, random_state=4)
    poses = tree.compute_poses(position, rotation.as_matrix(), values)
    for k in range(4):
        tangent = np.zeros(model.nv)
        for joint, value in zip(tree.joint_names, values[k], strict=True):
            tangent[model.idx_vs[model.getJointId(joint)]] = value
        q = pin.integrate(model, pin.neutral(model), tangent)
        q[:3], q[3:7] = position[k], rotation[k].as_quat()
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacements(model, data)
        for link, link_name in enumerate(tree.link_names):
            frame = data.oMf[model.getFrameId(link_name, pin.FrameType.BODY)]
            assert poses.position[k, link] == pytest.approx(frame.translation, abs=1e-9)
            assert poses.rotation[k, link] == pytest.approx(frame.rotation, abs=1e-9)


def test_plans_without_links_are_refused(planned_scenes: PlannedScenes) -> None:
    for name, words in (("modules", "expected a climb"), ("walk", "links are not exported")):
        path = planned_scenes[name]
        with pytest.raises(UsageError, match=words):
            identify_kind(path).read_tracked_motion(path, None)


@pytest.mark.parametrize("rate", [0.0, 5000.0, 1e-3])
def test_rates_that_cannot_be(climb: Path, rate: float) -> None:
    with pytest.raises(UsageError, match="--rate"):
        read_tracked_motion(climb, rate)
