"""A plan's motion in a format, by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.errors import UsageError
from climbplan.exports.gains import read_gains
from climbplan.exports.motion import RobotMotion, at_rate, for_gains, gain_words
from climbplan.exports.ros2_control import write_controller
from climbplan.exports.ros_files import write_bag, write_mcap
from climbplan.exports.tables import write_arrays, write_table
from climbplan.exports.usd_file import write_usd

FACTS = "export.json"  # in directories: what was exported how


@dataclass(frozen=True)
class Format:
    """One way to write a motion."""

    name: str  # of the file or directory beside the plan
    write: Callable[[RobotMotion, Path], None]  # to a file, or into an empty directory
    directory: bool = False


@dataclass(frozen=True)
class Told:
    """What a controller is told: how often, for which gains, with torques or without."""

    rate: float | None = None  # [Hz], the plan's own samples if left out
    gains: str | None = None  # a number [N m/rad] or a file
    feedforward: bool = False


def told(motion: RobotMotion, how: Told) -> RobotMotion:
    """The motion as a controller is told it.

    Raises UsageError for rates and gains that cannot be, and gains of a motion without torques.
    """
    joints = motion.joints
    if how.gains is not None or how.feedforward:
        if joints is None or not (joints.gain > 0).all():
            raise UsageError(f"--gains, --feedforward: {'; '.join(motion.words)}")
        gain = (
            joints.gain if how.gains is None else read_gains(how.gains, joints.names, joints.slides)
        )
        joints = for_gains(joints, gain, how.feedforward, motion.time)
        motion = replace(
            motion, joints=joints, words=(gain_words(gain, how.feedforward, joints.slides),)
        )
    return motion if how.rate is None else at_rate(motion, how.rate)


def _bag(motion: RobotMotion, directory: Path) -> None:
    write_bag(motion, directory / "bag")
    _facts(motion, directory)


def _controller(motion: RobotMotion, directory: Path) -> None:
    span = float(motion.time[-1] - motion.time[0])
    rate = (len(motion.time) - 1) / span if span > 0 else 1.0
    write_controller(motion, directory, max(rate, 1.0))
    _facts(motion, directory)


def _facts(motion: RobotMotion, directory: Path) -> None:
    facts = {
        "name": motion.name,
        "robot": motion.robot,
        "samples": len(motion.time),
        "seconds": float(motion.time[-1] - motion.time[0]),
        "words": list(motion.words),
    }
    (directory / FACTS).write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")


FORMATS: dict[str, Format] = {
    "csv": Format("motion.csv", write_table),
    "npz": Format("motion.npz", write_arrays),
    "mcap": Format("motion.mcap", write_mcap),
    "ros2": Format("ros2_bag", _bag, directory=True),
    "jtc": Format("ros2_control", _controller, directory=True),
    "usd": Format("motion.usd", write_usd),
}
