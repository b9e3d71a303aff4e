"""Files for `joint_trajectory_controller` of ros2_control: its parameters, and a goal to send."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.exports.damping import update_rate
from climbplan.exports.motion import ExportedJoints, RobotMotion
from climbplan.exports.ros_messages import convert_to_nanoseconds

CONTROLLER = "joint_trajectory_controller"
_GOAL = "/joint_trajectory_controller/follow_joint_trajectory"
POSITION_RATE = 100.0  # [Hz] of motors that control positions by themselves
# Digits of goals, far below what encoders and motors resolve: splines between two points of 20 Hz
# move by less than 1e-6 rad by what is rounded off
POSITION_DECIMALS = 6  # of angles [rad] and slides [m]
_VELOCITY_DECIMALS = 4  # [rad/s]
_ACCELERATION_DECIMALS = 3  # [rad/s^2]
_EFFORT_DECIMALS = 3  # [N m]
_ROOM = 0.1  # [rad] of tracking errors beside what contacts bend joints by


def write_controller(motion: RobotMotion, directory: Path) -> None:
    """Write `controllers.yaml` and `goal.yaml`; raises UsageError for a motion without joints."""
    joints = motion.joints
    if joints is None:
        raise UsageError(f"{motion.name}: no joints to control: {'; '.join(motion.words)}")
    text = _write_head(motion) + yaml.safe_dump(_build_parameters(joints), sort_keys=False)
    (directory / "controllers.yaml").write_text(text, encoding="utf-8")
    with (directory / "goal.yaml").open("w", encoding="utf-8") as stream:
        for line in _write_goal(motion, joints):
            stream.write(line + "\n")


def _write_head(motion: RobotMotion) -> str:
    comments = [*motion.words]
    if motion.joints is not None and motion.joints.limits is not None:
        comments += [
            "p and d act on torques: a controller of 20 Hz throws a robot over that 500 Hz holds",
            "d damps a limb in the air critically; motors with damping of their own need less",
        ]
    if motion.joints is not None and motion.joints.has_gravity_effort:
        comments.append("effort holds the weight of links; without it in the controller they sag")
    return "".join(f"# {line}\n" for line in comments)


def _build_parameters(joints: ExportedJoints) -> dict[str, object]:
    by_torque = bool((joints.gain > 0).all())
    damping = np.zeros_like(joints.gain) if joints.limits is None else joints.limits.damping
    rate = update_rate(damping, joints.gain) if by_torque else POSITION_RATE
    tolerances = np.abs(joints.command - joints.angle).max(axis=0) + _ROOM
    controller_parameters: dict[str, object] = {
        "joints": list(joints.names),
        "command_interfaces": ["effort" if by_torque else "position"],
        "state_interfaces": ["position", "velocity"],
        "allow_nonzero_velocity_at_trajectory_end": False,
        "constraints": {
            "stopped_velocity_tolerance": 0.05,
            **{
                name: {"trajectory": round(float(tolerance), 4), "goal": round(float(tolerance), 4)}
                for name, tolerance in zip(joints.names, tolerances, strict=True)
            },
        },
    }
    if by_torque:
        controller_parameters["gains"] = {
            name: {"p": float(p), "i": 0.0, "d": float(f"{d:.4g}"), "ff_velocity_scale": 0.0}
            for name, p, d in zip(joints.names, joints.gain, damping, strict=True)
        }
    return {
        "controller_manager": {
            "ros__parameters": {
                "update_rate": round(rate),
                CONTROLLER: {"type": f"{CONTROLLER}/JointTrajectoryController"},
            }
        },
        CONTROLLER: {"ros__parameters": controller_parameters},
    }


def _write_goal(motion: RobotMotion, joints: ExportedJoints) -> Iterator[str]:
    """Yield YAML of a FollowJointTrajectory goal, a point a line."""
    yield from (f"# {line}" for line in motion.words)
    yield f"# A goal of {_GOAL}, control_msgs/action/FollowJointTrajectory;"
    yield "# more than a shell takes as an argument: examples/ros2/follow_plan.py sends it"
    yield "trajectory:"
    yield f"  joint_names: [{', '.join(_quote_name(name) for name in joints.names)}]"
    yield "  points:"
    for k, time in enumerate(motion.time - motion.time[0]):
        seconds, nanosec = divmod(convert_to_nanoseconds(float(time)), 1_000_000_000)
        fields = [
            f"positions: {_format_numbers(joints.command[k], POSITION_DECIMALS)}",
            f"velocities: {_format_numbers(joints.velocity[k], _VELOCITY_DECIMALS)}",
            f"accelerations: {_format_numbers(joints.acceleration[k], _ACCELERATION_DECIMALS)}",
            f"time_from_start: {{sec: {seconds}, nanosec: {nanosec}}}",
        ]
        if joints.effort.any():
            fields.insert(3, f"effort: {_format_numbers(joints.effort[k], _EFFORT_DECIMALS)}")
        yield f"  - {{{', '.join(fields)}}}"


def _format_numbers(values: Array, decimals: int) -> str:
    """Format a list of floats, zeros behind the last digit left out."""
    texts = (f"{value + 0.0:.{decimals}f}".rstrip("0") for value in np.round(values, decimals))
    return f"[{', '.join(f'{text}0' if text.endswith('.') else text for text in texts)}]"


def _quote_name(name: str) -> str:
    return "'" + name.replace("'", "''") + "'"
