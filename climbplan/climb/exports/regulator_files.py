"""The files of a robot's joint regulator: its code, the plan's tables, the time of a tick."""

from __future__ import annotations

import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import BoolArray
from climbplan.climb.exports.motion import build_motion
from climbplan.climb.plan.file import read_climb
from climbplan.climb.simulation.control.regulator import build_regulator_tables, compute_zero_pose
from climbplan.control import joint_regulator
from climbplan.control.joint_regulator import JointRegulator, RegulatorTables
from climbplan.errors import UsageError
from climbplan.exports.formats import FACTS, ControllerOptions, adapt_motion
from climbplan.exports.gains import RIGID
from climbplan.exports.sidecar import write_facts

TABLES, CODE = "regulator.npz", "joint_regulator.py"
_NUM_TIMED_TICKS = 2000  # that are timed


class TickTime(NamedTuple):
    """Computing times of regulator ticks on this machine [s]."""

    median: float
    percentile_99: float  # of 99 in 100


def write_regulator(path: Path, gains: str | None, directory: Path) -> TickTime:
    """Write code and tables of a climb's regulator into a directory, and time it.

    Args:
        path: The plan file.
        gains: A number [N m/rad], a file, or "rigid"; None for the robot's gains.
        directory: Where the files are written.

    Raises:
        UsageError: Invalid gains, or a robot with five-bar legs, grippers or flat feet.
        PlanFileError: The file is no climb's plan.
    """
    plan = read_climb(path)
    robot = plan.robot
    if robot.gripper is not None or robot.sole is not None or compute_zero_pose(robot) is None:
        raise UsageError(
            f"--format regulator: {robot.name} has five-bar legs, grippers or flat feet; the "
            "regulator knows "
            "limbs whose joints move one after the other and toes that press"
        )
    motion = adapt_motion(build_motion(plan), ControllerOptions(gains=gains))
    joints = motion.joints
    assert joints is not None
    has_joint, gain = robot.has_joint, None
    if gains == RIGID:  # what gives beyond the motors is in the joints, where encoders see it
        motor_stiffness = robot.joint_stiffness * (1 - robot.structural_compliance_share)
        rigid_robot = replace(
            robot, joint_stiffness=motor_stiffness, structural_compliance_share=0.0
        )
        plan = replace(plan, robot=rigid_robot)
    elif gains is not None:
        gain = _scatter_joints(joints.gain, has_joint, robot.joint_stiffness)
    tables = build_regulator_tables(plan, gain)
    table_arrays = {f.name: getattr(tables, f.name) for f in fields(RegulatorTables)}
    names = np.array(joints.names)
    extra_arrays = {
        "joint_names": _scatter_joints(names, has_joint, np.full(has_joint.shape, "", names.dtype)),
        "gain": _scatter_joints(joints.gain, has_joint, np.zeros(has_joint.shape)),
        "gravity": _scatter_joints(
            joints.gravity, has_joint, np.zeros((len(motion.time), *has_joint.shape))
        ),
    }
    if joints.limits is not None:
        extra_arrays["damping"] = _scatter_joints(
            joints.limits.damping, has_joint, np.zeros(has_joint.shape)
        )
    if motion.base is not None:
        extra_arrays["base_position"] = motion.base.position
        extra_arrays["base_quaternion"] = motion.base.quaternion
        extra_arrays["base_link"] = np.array(motion.base.name)
    arrays: dict[str, NDArray[Any]] = {**extra_arrays, **table_arrays}
    np.savez_compressed(directory / TABLES, allow_pickle=False, **arrays)
    write_facts(motion, directory / FACTS)
    code = Path(joint_regulator.__file__).read_text(encoding="utf-8")
    (directory / CODE).write_text(code, encoding="utf-8")
    return measure_tick_time(tables)


def measure_tick_time(tables: RegulatorTables) -> TickTime:
    """Measure the time of ticks through the plan, with angles as planned."""
    regulator = JointRegulator(tables)
    moments = np.linspace(tables.time[0], tables.time[-1], _NUM_TIMED_TICKS)
    sample = np.searchsorted(tables.time, moments, side="right") - 1
    angles = tables.command + tables.deflection / tables.compliance_ratio
    durations = []
    for moment, sample_index in zip(moments.tolist(), sample.tolist(), strict=True):
        measured_angles = angles[sample_index]
        start_time = time.perf_counter()
        regulator.tick(moment, measured_angles)
        durations.append(time.perf_counter() - start_time)
    return TickTime(float(np.median(durations)), float(np.percentile(durations, 99)))


def _scatter_joints(
    values: NDArray[Any], has_joint: BoolArray, empty: NDArray[Any]
) -> NDArray[Any]:
    """Return values (..., count) of existing joints as (..., N, J), with those of `empty`
    elsewhere.
    """
    scattered = np.broadcast_to(empty, (*empty.shape[:-2], *has_joint.shape)).copy()
    scattered[..., has_joint] = values
    return scattered
