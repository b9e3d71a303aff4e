"""The formats of exported motions, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.errors import UsageError
from climbplan.exports.gains import RIGID, read_gains
from climbplan.exports.motion import (
    ExportedJoints,
    RobotMotion,
    convert_to_gains,
    convert_to_rigid_links,
    describe_gains,
    describe_rigid_gains,
    replace_gain,
)
from climbplan.exports.ros2_control import write_controller
from climbplan.exports.ros_files import write_bag, write_mcap
from climbplan.exports.sampling import add_load_ramps, resample_at_rate
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
class ControllerOptions:
    """Options of the exported motion: rate, gains, feed-forward torques, load ramps."""

    rate: float | None = None  # [Hz], the plan's own samples if left out
    gains: str | None = None  # a number [N m/rad], a file, or "rigid"
    feedforward: bool = False
    gravity: bool = False  # the weight of links is part of `effort`
    ramp: float = 0.0  # [s] of load ramps before and after the plan; 0: none


def adapt_motion(motion: RobotMotion, options: ControllerOptions) -> RobotMotion:
    """Return the motion resampled and with commands for the given gains.

    Args:
        motion: The motion of a plan.
        options: Rate, gains, feedforward, gravity and ramp; None leaves the plan's own.

    Raises:
        UsageError: Rates, gains or ramps are impossible, or gains are given for a motion without
            torques.
    """
    if motion.sampler is not None and options.rate is not None:
        motion = resample_at_rate(motion, options.rate)
    if options.gains is not None or options.feedforward:
        if motion.joints is None or not (motion.joints.gain > 0).all():
            raise UsageError(f"--gains, --feedforward: {'; '.join(motion.words)}")
        motion = _apply_gains(motion, motion.joints, options)
    if options.gravity:
        if motion.joints is None or motion.joints.limits is None:
            raise UsageError(f"--gravity: {'; '.join(motion.words)}")
        motion = replace(motion, joints=replace(motion.joints, has_gravity_effort=True))
    if motion.sampler is None and options.rate is not None:
        motion = resample_at_rate(motion, options.rate)
    return add_load_ramps(motion, options.ramp) if options.ramp else motion


def _apply_gains(
    motion: RobotMotion, joints: ExportedJoints, options: ControllerOptions
) -> RobotMotion:
    """Return the motion with commands for other gains; the first of its notes describes them."""
    if motion.sampler is not None:  # torques of a walk jump, so they are always a feed-forward
        gain = joints.gain
        if options.gains == RIGID and joints.limits is not None:
            gain = joints.limits.rigid_gain
        elif options.gains is not None:
            gain = read_gains(options.gains, joints.names, joints.slides)
        return replace(motion, joints=replace_gain(joints, gain))
    if options.gains == RIGID:
        adapted = convert_to_rigid_links(joints, options.feedforward, motion.time)
        description = describe_rigid_gains(adapted.gain, joints.slides)
    else:
        gain = (
            joints.gain
            if options.gains is None
            else read_gains(options.gains, joints.names, joints.slides)
        )
        adapted = convert_to_gains(joints, gain, options.feedforward, motion.time)
        description = describe_gains(gain, options.feedforward, joints.slides)
    return replace(motion, joints=adapted, words=(description, *motion.words[1:]))


def apply_trajectory_controller_defaults(
    motion: RobotMotion, options: ControllerOptions
) -> ControllerOptions:
    """Return options with the defaults of a trajectory controller: load ramps, weight of links.

    Args:
        motion: The motion of a plan; without torques the options stay as they are.
        options: Options as they were given.
    """
    joints = motion.joints
    if joints is None or joints.limits is None:
        return options
    return replace(options, gravity=True, ramp=0.0 if motion.sampler is not None else _JTC_RAMP)


def _write_table(motion: RobotMotion, out: Path) -> None:
    write_table(motion, out)
    write_sidecar(motion, out)


def _write_bag(motion: RobotMotion, directory: Path) -> None:
    write_bag(motion, directory / "bag")
    write_facts(motion, directory / FACTS)


def _write_controller_files(motion: RobotMotion, directory: Path) -> None:
    write_controller(motion, directory)
    write_facts(motion, directory / FACTS)


FORMATS: dict[str, Format] = {
    "csv": Format("motion.csv", _write_table),
    "npz": Format("motion.npz", write_arrays),
    "mcap": Format("motion.mcap", write_mcap),
    "ros2": Format("ros2_bag", _write_bag, directory=True),
    "jtc": Format("ros2_control", _write_controller_files, directory=True),
    "usd": Format("motion.usd", write_usd),
}
