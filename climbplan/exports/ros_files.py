"""A motion as an MCAP file and as a bag of ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from climbplan.errors import MissingSolver, UsageError
from climbplan.exports.motion import RobotMotion
from climbplan.exports.ros_messages import Messages, load_typestore
from climbplan.store.atomic_file import replace_atomically

BAG_VERSION: Final = 9  # of rosbag2's metadata


def write_mcap(motion: RobotMotion, out: Path) -> None:
    """Write one file with schemas, as Foxglove and `ros2 bag` read it.

    Raises MissingSolver without the extra `ros`, UsageError if the file cannot be written.
    """
    types = load_typestore()
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError as error:
        raise MissingSolver("MCAP files need mcap: pip install 'climbplan[ros]'") from error
    with replace_atomically(out) as temporary_path, temporary_path.open("wb") as stream:
        writer: Any = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="climbplan")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for number, stamped in enumerate(Messages(motion, types).build_all()):
            if stamped.kind not in schemas:
                text, _ = types.generate_msgdef(stamped.kind, ros_version=2)
                schemas[stamped.kind] = writer.register_schema(
                    stamped.kind, "ros2msg", text.encode()
                )
            if stamped.topic not in channels:
                channels[stamped.topic] = writer.register_channel(
                    stamped.topic, "cdr", schemas[stamped.kind]
                )
            writer.add_message(
                channels[stamped.topic],
                log_time=stamped.time,
                data=bytes(types.serialize_cdr(stamped.message, stamped.kind)),
                publish_time=stamped.time,
                sequence=number,
            )
        writer.add_metadata("climbplan", {"name": motion.name, "words": "\n".join(motion.words)})
        writer.finish()


def write_bag(motion: RobotMotion, directory: Path) -> None:
    """Write a bag of ROS 2 into a new directory: SQLite storage and metadata.

    Raises MissingSolver without the extra `ros`, UsageError if the bag cannot be written.
    """
    types = load_typestore()
    import sqlite3

    from rosbags.rosbag2 import Writer, WriterError

    try:
        _write_messages(motion, types, Writer(directory, version=BAG_VERSION))
    except (sqlite3.Error, WriterError) as error:
        raise UsageError(f"{directory}: cannot be written: {error}") from error


def _write_messages(motion: RobotMotion, types: Any, writer: Any) -> None:
    with writer:
        connections = {}
        for stamped in Messages(motion, types).build_all():
            if stamped.topic not in connections:
                connections[stamped.topic] = writer.add_connection(
                    stamped.topic, stamped.kind, typestore=types
                )
            data = types.serialize_cdr(stamped.message, stamped.kind)
            writer.write(connections[stamped.topic], stamped.time, data)
