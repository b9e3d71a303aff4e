"""A plan's motion in a format, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.errors import UsageError
from climbplan.exports.gains import RIGID, read_gains
from climbplan.exports.motion import (
    JointMotion,
    RobotMotion,
    for_gains,
    for_rigid_links,
    gain_words,
    rigid_words,
    with_gain,
)
from climbplan.exports.ros2_control import write_controller
from climbplan.exports.ros_files import write_bag, write_mcap
from climbplan.exports.sampling import at_rate, with_ramps
from climbplan.exports.sidecar import write_facts, write_sidecar
from climbplan.exports.tables import write_arrays, write_table
from climbplan.exports.usd_file import write_usd

FACTS = "export.json"  # in directories: what was exported how
_JTC_RAMP = 3.0  # [s]


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
    gains: str | None = None  # a number [N m/rad], a file, or "rigid"
    feedforward: bool = False
    gravity: bool = False  # the weight of links is part of `effort`
    ramp: float = 0.0  # [s] of load ramps before and after the plan; 0: none


def told(motion: RobotMotion, how: Told) -> RobotMotion:
    """The motion as a controller is told it.

    Raises UsageError for rates, gains and ramps that cannot be, and gains of a motion without
    torques.
    """
    if motion.sampler is not None and how.rate is not None:
        motion = at_rate(motion, how.rate)
    if how.gains is not None or how.feedforward:
        if motion.joints is None or not (motion.joints.gain > 0).all():
            raise UsageError(f"--gains, --feedforward: {'; '.join(motion.words)}")
        motion = _for_gains(motion, motion.joints, how)
    if how.gravity:
        if motion.joints is None or motion.joints.limits is None:
            raise UsageError(f"--gravity: {'; '.join(motion.words)}")
        motion = replace(motion, joints=replace(motion.joints, has_gravity_effort=True))
    if motion.sampler is None and how.rate is not None:
        motion = at_rate(motion, how.rate)
    return with_ramps(motion, how.ramp) if how.ramp else motion


def _for_gains(motion: RobotMotion, joints: JointMotion, how: Told) -> RobotMotion:
    """The motion under another controller's gains, the first of its words about them."""
    if motion.sampler is not None:  # torques of a walk jump: they are always told apart
        gain = joints.gain
        if how.gains == RIGID and joints.limits is not None:
            gain = joints.limits.rigid_gain
        elif how.gains is not None:
            gain = read_gains(how.gains, joints.names, joints.slides)
        return replace(motion, joints=with_gain(joints, gain))
    if how.gains == RIGID:
        own = for_rigid_links(joints, how.feedforward, motion.time)
        said = rigid_words(own.gain, joints.slides)
    else:
        gain = (
            joints.gain if how.gains is None else read_gains(how.gains, joints.names, joints.slides)
        )
        own = for_gains(joints, gain, how.feedforward, motion.time)
        said = gain_words(gain, how.feedforward, joints.slides)
    return replace(motion, joints=own, words=(said, *motion.words[1:]))


def for_controller(motion: RobotMotion, how: Told) -> Told:
    """What a trajectory controller is told where nobody says: ramps, and the weight of links."""
    joints = motion.joints
    if joints is None or joints.limits is None:
        return how
    return replace(how, gravity=True, ramp=0.0 if motion.sampler is not None else _JTC_RAMP)


def _table(motion: RobotMotion, out: Path) -> None:
    write_table(motion, out)
    write_sidecar(motion, out)


def _bag(motion: RobotMotion, directory: Path) -> None:
    write_bag(motion, directory / "bag")
    write_facts(motion, directory / FACTS)


def _controller(motion: RobotMotion, directory: Path) -> None:
    write_controller(motion, directory)
    write_facts(motion, directory / FACTS)


FORMATS: dict[str, Format] = {
    "csv": Format("motion.csv", _table),
    "npz": Format("motion.npz", write_arrays),
    "mcap": Format("motion.mcap", write_mcap),
    "ros2": Format("ros2_bag", _bag, directory=True),
    "jtc": Format("ros2_control", _controller, directory=True),
    "usd": Format("motion.usd", write_usd),
}
