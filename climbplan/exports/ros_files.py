"""A motion as an MCAP file and as a bag of ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from climbplan.errors import MissingSolver, UsageError
from climbplan.exports.motion import RobotMotion
from climbplan.exports.ros_messages import Messages, typestore
from climbplan.store.atomic_file import written_aside

BAG_VERSION: Final = 9  # of rosbag2's metadata


def write_mcap(motion: RobotMotion, out: Path) -> None:
    """One file with schemas, as Foxglove and `ros2 bag` read it.

    Raises MissingSolver without the extra `ros`, UsageError if the file cannot be written.
    """
    types = typestore()
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError as error:
        raise MissingSolver("MCAP files need mcap: pip install 'climbplan[ros]'") from error
    with written_aside(out) as aside, aside.open("wb") as stream:
        writer: Any = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="climbplan")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for number, one in enumerate(Messages(motion, types).all()):
            if one.kind not in schemas:
                text, _ = types.generate_msgdef(one.kind, ros_version=2)
                schemas[one.kind] = writer.register_schema(one.kind, "ros2msg", text.encode())
            if one.topic not in channels:
                channels[one.topic] = writer.register_channel(one.topic, "cdr", schemas[one.kind])
            writer.add_message(
                channels[one.topic],
                log_time=one.time,
                data=bytes(types.serialize_cdr(one.message, one.kind)),
                publish_time=one.time,
                sequence=number,
            )
        writer.add_metadata("climbplan", {"name": motion.name, "words": "\n".join(motion.words)})
        writer.finish()


def write_bag(motion: RobotMotion, directory: Path) -> None:
    """A bag of ROS 2 in a directory that is not there yet: SQLite storage and metadata.

    Raises MissingSolver without the extra `ros`, UsageError if the bag cannot be written.
    """
    types = typestore()
    import sqlite3

    from rosbags.rosbag2 import Writer, WriterError

    try:
        _write_messages(motion, types, Writer(directory, version=BAG_VERSION))
    except (sqlite3.Error, WriterError) as error:
        raise UsageError(f"{directory}: cannot be written: {error}") from error


def _write_messages(motion: RobotMotion, types: Any, writer: Any) -> None:
    with writer:
        connections = {}
        for one in Messages(motion, types).all():
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(one.topic, one.kind, typestore=types)
            data = types.serialize_cdr(one.message, one.kind)
            writer.write(connections[one.topic], one.time, data)
