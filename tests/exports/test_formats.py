"""Every format read back by a library that did not write it."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import yaml

from climbplan.cli.export import FormatName
from climbplan.climb.exports.motion import read_motion as climb_motion
from climbplan.errors import UsageError
from climbplan.exports.formats import FORMATS, ControllerOptions, adapt_motion
from climbplan.exports.motion import RobotMotion
from climbplan.exports.ros_messages import name_contact_topics
from climbplan.limms.exports.motion import read_motion as limms_motion
from climbplan.walking.exports.motion import read_motion as walk_motion

READERS = {"climb": climb_motion, "modules": limms_motion, "walk": walk_motion}


def build_motion(plans: dict[str, Path], kind: str) -> RobotMotion:
    return READERS[kind](plans[kind])


def counted(motion: RobotMotion) -> dict[str, int]:
    samples = len(motion.time)
    wanted = {"/tf": samples}
    if motion.joints is not None:
        wanted |= {"/joint_states": samples, "/joint_trajectory": 1}
    if motion.contacts is not None:
        wanted |= {f"/contacts/{name}": samples for name in motion.contacts.names}
    if motion.latches is not None:
        wanted["/latches"] = samples
    if motion.surfaces:
        wanted["/surfaces"] = 1
    return wanted


def test_the_command_takes_every_format() -> None:
    assert get_args(FormatName) == (*FORMATS, "motion", "regulator")


@pytest.mark.parametrize("kind", sorted(READERS))
def test_mcap(plans: dict[str, Path], tmp_path: Path, kind: str) -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    read = pytest.importorskip("mcap_ros2.reader")  # decodes by the schemas in the file
    motion, path = build_motion(plans, kind), tmp_path / "motion.mcap"
    FORMATS["mcap"].write(motion, path)
    count: dict[str, int] = {}
    times: list[int] = []
    for one in read.read_ros2_messages(str(path)):
        topic, message = one.channel.topic, one.ros_msg
        at = count.get(topic, 0)
        count[topic] = at + 1
        if topic == "/tf":
            times.append(one.log_time_ns)
            for body, given in zip(motion.placed, message.transforms, strict=True):
                assert given.child_frame_id == body.name
                place = given.transform.translation
                assert [place.x, place.y, place.z] == body.position[at].tolist()
        if topic == "/joint_states":
            assert motion.joints is not None
            assert tuple(message.name) == motion.joints.names
            assert list(message.position) == motion.joints.angle[at].tolist()
            assert list(message.effort) == motion.joints.torque[at].tolist()
        if topic == "/joint_trajectory":
            assert motion.joints is not None
            assert tuple(message.joint_names) == motion.joints.names
            for k, point in enumerate(message.points):
                assert list(point.positions) == motion.joints.command[k].tolist()
                assert list(point.velocities) == motion.joints.velocity[k].tolist()
                assert list(point.effort) == motion.joints.feedforward[k].tolist()
        if topic.startswith("/contacts/"):
            assert motion.contacts is not None
            c = motion.contacts.names.index(topic.rpartition("/")[2])
            force = message.wrench.force
            assert [force.x, force.y, force.z] == motion.contacts.force[at, c].tolist()
    assert count == counted(motion)
    assert times == sorted(times)
    assert np.array(times) / 1e9 == pytest.approx(motion.time, abs=1e-9)


def test_topics_are_such_as_ros_takes() -> None:
    names = ("RF", "left foot", "left_foot", "1", "é")
    topics = name_contact_topics(names)
    assert topics[:2] == ("/contacts/RF", "/contacts/left_foot")
    assert len(set(topics)) == len(names)
    assert all(re.fullmatch(r"/contacts/[A-Za-z0-9_]+", topic) for topic in topics)


def test_bag_of_ros_2(plans: dict[str, Path], tmp_path: Path) -> None:
    """SQLite by the standard library, and the metadata that ROS reads."""
    pytest.importorskip("rosbags")
    import sqlite3

    motion = build_motion(plans, "climb")
    FORMATS["ros2"].write(motion, tmp_path)
    (stored,) = (tmp_path / "bag").glob("*.db3")
    with sqlite3.connect(stored) as connection:
        query = (
            "select topics.name, count(*) from messages join topics on topics.id = topic_id "
            "group by topics.name"
        )
        assert dict(connection.execute(query).fetchall()) == counted(motion)
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8"))
    about = metadata["rosbag2_bagfile_information"]
    assert about["message_count"] == sum(counted(motion).values())
    assert json.loads((tmp_path / "export.json").read_text(encoding="utf-8"))["samples"]


def test_controller(plans: dict[str, Path], tmp_path: Path) -> None:
    motion = adapt_motion(
        build_motion(plans, "climb"), ControllerOptions(rate=10.0, gains="80", feedforward=True)
    )
    assert motion.joints is not None
    FORMATS["jtc"].write(motion, tmp_path)
    controllers = (tmp_path / "controllers.yaml").read_text(encoding="utf-8")
    assert "torques told beside them" in controllers
    stored = yaml.safe_load(controllers)
    own = stored["joint_trajectory_controller"]["ros__parameters"]
    assert tuple(own["joints"]) == motion.joints.names
    assert {gain["p"] for gain in own["gains"].values()} == {80.0}
    goal = yaml.safe_load((tmp_path / "goal.yaml").read_text(encoding="utf-8"))["trajectory"]
    assert tuple(goal["joint_names"]) == motion.joints.names
    points = goal["points"]
    assert len(points) == len(motion.time)
    for name, values, error in (
        ("positions", motion.joints.command, 1e-6),
        ("velocities", motion.joints.velocity, 1e-4),
        ("accelerations", motion.joints.acceleration, 1e-3),
        ("effort", motion.joints.feedforward, 1e-3),
    ):
        given = np.array([point[name] for point in points], float)
        assert given == pytest.approx(values, abs=error)
    after = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    assert np.array(after) == pytest.approx(motion.time - motion.time[0], abs=1e-9)


def test_modules_are_controlled_by_position(plans: dict[str, Path], tmp_path: Path) -> None:
    FORMATS["jtc"].write(build_motion(plans, "modules"), tmp_path)
    stored = yaml.safe_load((tmp_path / "controllers.yaml").read_text(encoding="utf-8"))
    own = stored["joint_trajectory_controller"]["ros__parameters"]
    assert own["command_interfaces"] == ["position"]
    assert "gains" not in own


@pytest.mark.parametrize("kind", sorted(READERS))
def test_tables_and_arrays(plans: dict[str, Path], tmp_path: Path, kind: str) -> None:
    motion = build_motion(plans, kind)
    FORMATS["csv"].write(motion, tmp_path / "motion.csv")
    with (tmp_path / "motion.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["time_s"]) for row in rows] == motion.time.tolist()
    FORMATS["npz"].write(motion, tmp_path / "motion.npz")
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as arrays:
        if motion.joints is not None:
            name = motion.joints.names[1]
            column = [float(row[f"{name}_position_rad"]) for row in rows]
            assert column == arrays["joint/position"][:, 1].tolist()
            assert tuple(arrays["joint/names"]) == motion.joints.names


@pytest.mark.parametrize("raises", [True, False])
def test_usd_on_a_full_disk(
    plans: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, raises: bool
) -> None:
    """The library raises an error without words, or returns False."""
    pytest.importorskip("pxr")
    from pxr import Tf, Usd

    def export(*_: object) -> bool:
        if raises:
            raise Tf.ErrorException("\n")
        return False

    monkeypatch.setattr(Usd.Stage, "Export", export)
    motion = build_motion(plans, "climb")
    with pytest.raises(UsageError, match=r"motion.usd: cannot be written: the disk may be full"):
        FORMATS["usd"].write(motion, tmp_path / "motion.usd")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", sorted(READERS))
def test_usd(plans: dict[str, Path], tmp_path: Path, kind: str) -> None:
    """Links reach from joint to joint at every sample."""
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    assert pxr
    motion = build_motion(plans, kind)
    FORMATS["usd"].write(motion, tmp_path / "motion.usda")
    assert (tmp_path / "motion.usda").read_text(encoding="utf-8").startswith("#usda")
    stage = Usd.Stage.Open(str(tmp_path / "motion.usda"))
    assert stage.GetEndTimeCode() == len(motion.time) - 1
    body = UsdGeom.Xformable(stage.GetPrimAtPath(f"/motion/{motion.bodies[0].name}"))
    place = body.GetLocalTransformation(stage.GetEndTimeCode()).ExtractTranslation()
    assert list(place) == pytest.approx(motion.bodies[0].position[-1].tolist())
    for limb in motion.limbs:
        link = UsdGeom.Capsule(stage.GetPrimAtPath(f"/motion/{limb.name}/link1"))
        half = link.GetHeightAttr().Get() / 2
        turn = UsdGeom.Xformable(link).GetLocalTransformation(stage.GetEndTimeCode())
        top = turn.Transform((0.0, 0.0, half))
        assert list(top) == pytest.approx(limb.points[-1, 2].tolist(), abs=2e-4)
