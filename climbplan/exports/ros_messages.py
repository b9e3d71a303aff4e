"""A motion as ROS 2 messages, without ROS: names and fields of the Jazzy message definitions.

/joint_trajectory: what controllers are told, in one message. /joint_states: angles and torques as
sensors will see them. /tf: world to each body. /contacts/NAME: force on the robot. /surfaces: what
may be touched.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import MissingSolver
from climbplan.exports.motion import BodyMotion, RobotMotion

WORLD = "world"
_COLOUR = (0.62, 0.66, 0.72, 0.6)


@dataclass(frozen=True)
class Stamped:
    """A message and when it is published."""

    topic: str
    kind: str  # such as sensor_msgs/msg/JointState
    time: int  # [ns]
    message: Any


def load_typestore() -> Any:
    """Return the message types of ROS 2; raises MissingSolver without rosbags."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingSolver("ROS files need rosbags: pip install 'climbplan[ros]'") from error
    return get_typestore(Stores.ROS2_JAZZY)


class Messages:
    """Builds the messages of one motion."""

    def __init__(self, motion: RobotMotion, types: Any) -> None:
        self._motion, self._types = motion, types.types
        self._topics = () if motion.contacts is None else name_contact_topics(motion.contacts.names)

    def build_all(self) -> Iterator[Stamped]:
        """Return the messages in order of time; constant ones come first."""
        motion = self._motion
        begin = convert_to_nanoseconds(float(motion.time[0]))
        if motion.joints is not None:
            kind = "trajectory_msgs/msg/JointTrajectory"
            yield Stamped("/joint_trajectory", kind, begin, self.joint_trajectory())
        if motion.surfaces:
            kind = "visualization_msgs/msg/MarkerArray"
            yield Stamped("/surfaces", kind, begin, self._surfaces())
        for k, time in enumerate(motion.time):
            stamp_ns = convert_to_nanoseconds(float(time))
            transforms = [self._transform(body, k, stamp_ns) for body in motion.placed]
            yield Stamped(
                "/tf",
                "tf2_msgs/msg/TFMessage",
                stamp_ns,
                self._new("tf2_msgs/msg/TFMessage", transforms),
            )
            if motion.joints is not None:
                yield Stamped(
                    "/joint_states",
                    "sensor_msgs/msg/JointState",
                    stamp_ns,
                    self._state(k, stamp_ns),
                )
            if motion.latches is not None:
                yield Stamped(
                    "/latches", "sensor_msgs/msg/JointState", stamp_ns, self._latches(k, stamp_ns)
                )
            if motion.contacts is not None:
                for c in range(len(self._topics)):
                    force = motion.contacts.force[k, c]
                    kind = "geometry_msgs/msg/WrenchStamped"
                    yield Stamped(self._topics[c], kind, stamp_ns, self._wrench(force, stamp_ns))

    def joint_trajectory(self) -> Any:
        """Return the whole motion; `effort` is what is told beside the commands."""
        joints = self._motion.joints
        assert joints is not None
        begin = float(self._motion.time[0])
        points = [
            self._new(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                joints.command[k],
                joints.velocity[k],
                joints.acceleration[k],
                joints.effort[k],
                self._duration(convert_to_nanoseconds(float(time) - begin)),
            )
            for k, time in enumerate(self._motion.time)
        ]
        return self._new(
            "trajectory_msgs/msg/JointTrajectory", self._header(0, ""), list(joints.names), points
        )

    def _state(self, k: int, stamp_ns: int) -> Any:
        joints = self._motion.joints
        assert joints is not None
        return self._new(
            "sensor_msgs/msg/JointState",
            self._header(stamp_ns, ""),
            list(joints.names),
            joints.angle[k],
            joints.velocity[k],
            joints.torque[k],
        )

    def _latches(self, k: int, stamp_ns: int) -> Any:
        """Return ends of modules with the numbers of what they hold, for want of a message of
        latches.
        """
        latches = self._motion.latches
        assert latches is not None
        empty_array = np.zeros(0)
        return self._new(
            "sensor_msgs/msg/JointState",
            self._header(stamp_ns, ""),
            list(latches.ends),
            latches.anchor[k].astype(float),
            empty_array,
            empty_array,
        )

    def _transform(self, body: BodyMotion, k: int, stamp_ns: int) -> Any:
        pose = self._new(
            "geometry_msgs/msg/Transform",
            self._new("geometry_msgs/msg/Vector3", *map(float, body.position[k])),
            self._new("geometry_msgs/msg/Quaternion", *map(float, body.quaternion[k])),
        )
        return self._new(
            "geometry_msgs/msg/TransformStamped", self._header(stamp_ns, WORLD), body.name, pose
        )

    def _wrench(self, force: Array, stamp_ns: int) -> Any:
        vector = "geometry_msgs/msg/Vector3"
        wrench = self._new(
            "geometry_msgs/msg/Wrench",
            self._new(vector, *map(float, force)),
            self._new(vector, 0.0, 0.0, 0.0),
        )
        return self._new("geometry_msgs/msg/WrenchStamped", self._header(stamp_ns, WORLD), wrench)

    def _surfaces(self) -> Any:
        """Return each surface as a fan of triangles."""
        markers = []
        for number, corners in enumerate(self._motion.surfaces):
            fan = [corners[[0, k, k + 1]] for k in range(1, len(corners) - 1)]
            points = [
                self._new("geometry_msgs/msg/Point", *map(float, point)) for point in np.vstack(fan)
            ]
            markers.append(self._marker(number, points))
        return self._new("visualization_msgs/msg/MarkerArray", markers)

    def _marker(self, number: int, points: list[Any]) -> Any:
        kind = self._types["visualization_msgs/msg/Marker"]
        identity = self._new(
            "geometry_msgs/msg/Pose",
            self._new("geometry_msgs/msg/Point", 0.0, 0.0, 0.0),
            self._new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
        )
        colour = self._new("std_msgs/msg/ColorRGBA", *_COLOUR)
        unit = self._new("geometry_msgs/msg/Vector3", 1.0, 1.0, 1.0)
        return kind(
            header=self._header(0, WORLD),
            ns="surfaces",
            id=number,
            type=kind.TRIANGLE_LIST,
            action=kind.ADD,
            pose=identity,
            scale=unit,
            color=colour,
            lifetime=self._duration(0),
            frame_locked=False,
            points=points,
            colors=[],
            texture_resource="",
            texture=self._new(
                "sensor_msgs/msg/CompressedImage", self._header(0, ""), "", np.zeros(0, np.uint8)
            ),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=self._new("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8)),
            mesh_use_embedded_materials=False,
        )

    def _header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self._new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))
        return self._new("std_msgs/msg/Header", stamp, frame)

    def _duration(self, length: int) -> Any:
        return self._new("builtin_interfaces/msg/Duration", *divmod(length, 1_000_000_000))

    def _new(self, kind: str, *fields: Any) -> Any:
        contiguous_fields = [
            np.ascontiguousarray(f) if isinstance(f, np.ndarray) else f for f in fields
        ]
        return self._types[kind](*contiguous_fields)


def name_contact_topics(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return one a name, of letters, digits and underscores as ROS wants them."""
    topic_names = [re.sub(r"[^A-Za-z0-9_]", "_", name) or "_" for name in names]
    return tuple(
        f"/contacts/{f'{name}_{k}' if name in topic_names[:k] else name}"
        for k, name in enumerate(topic_names)
    )


def convert_to_nanoseconds(seconds: float) -> int:
    """Return a time in whole nanoseconds, as ROS has it."""
    return round(seconds * 1e9)
