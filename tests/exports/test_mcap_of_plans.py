"""An MCAP of every kind of plan that moves says what the plan's own arrays say.

The file is written with mcap and rosbags; it is read with mcap-ros2-support, which decodes by the
schemas in the file, and the plan with h5py alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import climbplan
from climbplan.arrays import Array
from climbplan.cli.app import run

SPECS = Path(__file__).parents[2] / "specs"
NEAR = 1e-9
KINDS = {
    "climb": None,  # of the fixture
    "walk": None,
    "modules": None,
    "transition": {"name": "transition_flat"},
    "mission": {"name": "mission_ground_to_top"},
}


@dataclass
class Told:
    """What a file says, by topic."""

    count: Counter[str] = field(default_factory=Counter)
    stamps: dict[str, list[int]] = field(default_factory=dict)
    place: dict[str, list[list[float]]] = field(default_factory=dict)  # by frame
    turn: dict[str, list[list[float]]] = field(default_factory=dict)  # x, y, z, w
    states: list[Any] = field(default_factory=list)
    trajectory: Any = None
    force: dict[str, list[list[float]]] = field(default_factory=dict)  # by contact


def read(path: Path) -> Told:
    reader = pytest.importorskip("mcap_ros2.reader")
    told = Told()
    for one in reader.read_ros2_messages(str(path)):
        topic, message = one.channel.topic, one.ros_msg
        told.count[topic] += 1
        told.stamps.setdefault(topic, []).append(one.log_time_ns)
        if topic == "/tf":
            for frame in message.transforms:
                p, q = frame.transform.translation, frame.transform.rotation
                told.place.setdefault(frame.child_frame_id, []).append([p.x, p.y, p.z])
                told.turn.setdefault(frame.child_frame_id, []).append([q.x, q.y, q.z, q.w])
        elif topic == "/joint_states":
            told.states.append(message)
        elif topic == "/joint_trajectory":
            told.trajectory = message
        elif topic.startswith("/contacts/"):
            f = message.wrench.force
            told.force.setdefault(topic.rpartition("/")[2], []).append([f.x, f.y, f.z])
    return told


def matrix(rows: Iterator[Any]) -> Array:
    return np.array([list(row) for row in rows], float)


def turns(roll_pitch_yaw: Array) -> Rotation:
    """The body's attitude as the plan file says it: yaw, then pitch, then roll."""
    return Rotation.from_euler("ZYX", roll_pitch_yaw[:, ::-1])


def same_turns(told: list[list[float]], wanted: Rotation) -> bool:
    return bool((Rotation.from_quat(told).inv() * wanted).magnitude().max() < NEAR)


@pytest.fixture(params=sorted(KINDS))
def exported(
    request: pytest.FixtureRequest, plans: dict[str, Path], tmp_path: Path
) -> tuple[Path, Told]:
    """A plan file and its MCAP, read."""
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    kind = KINDS[request.param]
    plan = plans.get(request.param, tmp_path / "plan.h5")
    if kind is not None:
        climbplan.plan(SPECS / f"{kind['name']}.yaml").save(plan)
    assert run(["export", str(plan), "--format", "mcap", "-o", str(tmp_path / "x.mcap"), "-q"]) == 0
    return plan, read(tmp_path / "x.mcap")


def test_an_mcap_says_what_the_plan_says(exported: tuple[Path, Told]) -> None:
    path, told = exported
    with h5py.File(path) as plan:
        if "trajectory" in plan:
            climbs(plan, told)
        elif "limms" in plan:
            modules(plan, told)
        else:
            walks(plan, told)
    for topic, stamps in told.stamps.items():
        assert stamps == sorted(stamps), topic
    moving = np.array(told.stamps["/tf"]) / 1e9
    assert (np.diff(moving) > 0).all()


def climbs(plan: h5py.File, told: Told) -> None:
    """Climbs, transitions and missions."""
    moving = plan["trajectory"]
    samples = len(moving["time"])
    limbs = [name.decode() for name in plan["robot/limb_names"][:]]
    # Of a sample: poses, joints, each limb's wrench. Once: the trajectory and the surfaces
    assert told.count["/tf"] == told.count["/joint_states"] == samples
    assert told.count["/joint_trajectory"] == 1
    assert {name: len(rows) for name, rows in told.force.items()} == dict.fromkeys(limbs, samples)
    assert np.abs(np.array(told.stamps["/tf"]) / 1e9 - moving["time"][:]).max() < NEAR
    assert np.abs(np.array(told.place["body"]) - moving["com"][:]).max() < NEAR
    assert same_turns(told.turn["body"], turns(moving["rpy"][:]))
    names = list(told.trajectory.joint_names)
    assert names == [f"{limb}_{joint}" for limb in limbs for joint in ("coxa", "femur", "tibia")]
    assert all(list(state.name) == names for state in told.states)
    commands = matrix(point.positions for point in told.trajectory.points)
    assert np.abs(commands - moving["joint_command"][:].reshape(samples, -1)).max() < NEAR
    after = [
        p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in told.trajectory.points
    ]
    assert np.abs(np.array(after) - (moving["time"][:] - moving["time"][0])).max() < NEAR
    # Limbs in the air bear nothing
    contact = moving["contact"][:].astype(bool)
    for limb, name in enumerate(limbs):
        assert not np.array(told.force[name])[~contact[:, limb]].any()


def walks(plan: h5py.File, told: Told) -> None:
    legs = [name.decode() for name in plan["robot/leg_names"][:]]
    samples = len(plan["time"])
    assert told.count == {"/tf": samples} | {f"/contacts/{leg}": samples for leg in legs}
    assert np.abs(np.array(told.stamps["/tf"]) / 1e9 - plan["time"][:]).max() < NEAR
    assert np.abs(np.array(told.place["body"]) - plan["com"][:]).max() < NEAR
    assert same_turns(told.turn["body"], turns(plan["euler_zyx"][:]))
    force = plan["force"][:]
    force[-1] = force[-2]  # held until the end
    for n, leg in enumerate(legs):
        assert np.abs(np.array(told.force[leg]) - force[:, n]).max() < NEAR


def modules(plan: h5py.File, told: Told) -> None:
    time = plan["time"][:]
    kept = np.append(np.diff(time) > NEAR, True)  # where modes change a time is there twice
    samples = int(kept.sum())
    each = dict.fromkeys(("/tf", "/joint_states", "/latches"), samples)
    assert told.count == each | {"/joint_trajectory": 1}
    assert np.abs(np.array(told.stamps["/tf"]) / 1e9 - time[kept]).max() < NEAR
    assert np.abs(np.array(told.place["box"]) - plan["box/position"][:][kept, 0]).max() < NEAR
    modules = [name.decode() for name in plan["limms/name"][:]]
    names = [f"{module}_joint{j}" for module in modules for j in range(1, 7)]
    assert list(told.trajectory.joint_names) == names
    angles = plan["limms/joint_angles"][:][kept].reshape(samples, -1)
    states = matrix(state.position for state in told.states)
    assert np.abs(states - angles).max() < NEAR
    points = matrix(point.positions for point in told.trajectory.points)
    assert np.abs(points - angles).max() < NEAR
    speeds = plan["limms/joint_velocity"][:][kept].reshape(samples, -1)
    assert np.abs(matrix(s.velocity for s in told.states) - speeds).max() < NEAR


@pytest.mark.slow
def test_a_loop_of_pushes_too(tmp_path: Path) -> None:
    plan = tmp_path / "plan.h5"
    climbplan.plan(SPECS / "mpc_recovery.yaml").save(plan)
    assert run(["export", str(plan), "--format", "mcap", "-o", str(tmp_path / "x.mcap"), "-q"]) == 0
    with h5py.File(plan) as stored:
        walks(stored, read(tmp_path / "x.mcap"))
