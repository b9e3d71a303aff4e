"""The regulator that runs on a robot: its code as it is, the plan's tables, what a tick takes."""

from __future__ import annotations

import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import BoolArray
from climbplan.climb.exports.motion import motion_of_climb
from climbplan.climb.plan.file import read_climb
from climbplan.climb.simulation.control.regulator import build_regulator_tables, compute_zero_pose
from climbplan.control import joint_regulator
from climbplan.control.joint_regulator import JointRegulator, RegulatorTables
from climbplan.errors import UsageError
from climbplan.exports.formats import FACTS, ControllerOptions, adapt_motion
from climbplan.exports.gains import RIGID
from climbplan.exports.sidecar import write_facts

TABLES, CODE = "regulator.npz", "joint_regulator.py"
_TICKS = 2000  # that are timed


class TickTime(NamedTuple):
    """What ticks take on this machine [s]."""

    median: float
    most: float  # of 99 in 100


def write_regulator(path: Path, gains: str | None, directory: Path) -> TickTime:
    """Write code and tables of a climb's regulator into a directory, and time it.

    gains: a number [N m/rad], a file, or "rigid", the robot's if None. Raises UsageError for gains
    that cannot be and robots with five-bar legs or grippers, PlanFileError for what is no climb's
    plan.
    """
    plan = read_climb(path)
    robot = plan.robot
    if robot.gripper is not None or robot.sole is not None or compute_zero_pose(robot) is None:
        raise UsageError(
            f"--format regulator: {robot.name} has five-bar legs, grippers or flat feet; the "
            "regulator knows "
            "limbs whose joints move one after the other and toes that press"
        )
    motion = adapt_motion(motion_of_climb(plan), ControllerOptions(gains=gains))
    joints = motion.joints
    assert joints is not None
    there, gain = robot.has_joint, None
    if gains == RIGID:  # what gives beyond the motors is in the joints, where encoders see it
        firm = robot.joint_stiffness * (1 - robot.structural_compliance_share)
        own = replace(robot, joint_stiffness=firm, structural_compliance_share=0.0)
        plan = replace(plan, robot=own)
    elif gains is not None:
        gain = _placed(joints.gain, there, robot.joint_stiffness)
    tables = build_regulator_tables(plan, gain)
    table = {f.name: getattr(tables, f.name) for f in fields(RegulatorTables)}
    names = np.array(joints.names)
    more = {
        "joint_names": _placed(names, there, np.full(there.shape, "", names.dtype)),
        "gain": _placed(joints.gain, there, np.zeros(there.shape)),
        "gravity": _placed(joints.gravity, there, np.zeros((len(motion.time), *there.shape))),
    }
    if joints.limits is not None:
        more["damping"] = _placed(joints.limits.damping, there, np.zeros(there.shape))
    if motion.base is not None:
        more["base_position"] = motion.base.position
        more["base_quaternion"] = motion.base.quaternion
        more["base_link"] = np.array(motion.base.name)
    arrays: dict[str, NDArray[Any]] = {**more, **table}
    np.savez_compressed(directory / TABLES, allow_pickle=False, **arrays)
    write_facts(motion, directory / FACTS)
    code = Path(joint_regulator.__file__).read_text(encoding="utf-8")
    (directory / CODE).write_text(code, encoding="utf-8")
    return tick_time(tables)


def tick_time(tables: RegulatorTables) -> TickTime:
    """Of ticks through the plan, with angles as planned."""
    regulator = JointRegulator(tables)
    moments = np.linspace(tables.time[0], tables.time[-1], _TICKS)
    sample = np.searchsorted(tables.time, moments, side="right") - 1
    angles = tables.command + tables.bent / tables.give
    taken = []
    for moment, at in zip(moments.tolist(), sample.tolist(), strict=True):
        seen = angles[at]
        begin = time.perf_counter()
        regulator.tick(moment, seen)
        taken.append(time.perf_counter() - begin)
    return TickTime(float(np.median(taken)), float(np.percentile(taken, 99)))


def _placed(values: NDArray[Any], there: BoolArray, empty: NDArray[Any]) -> NDArray[Any]:
    """(..., N, J) values (..., count) of the joints that there are, beside those of `empty`."""
    placed = np.broadcast_to(empty, (*empty.shape[:-2], *there.shape)).copy()
    placed[..., there] = values
    return placed
