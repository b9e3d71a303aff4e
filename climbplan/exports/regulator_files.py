"""The regulator that runs on a robot: its code as it is, the plan's tables, what a tick takes."""

from __future__ import annotations

import time
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.climb.plan.file import read_climb
from climbplan.control import joint_regulator
from climbplan.control.joint_regulator import JointRegulator, RegulatorTables
from climbplan.errors import UsageError
from climbplan.exports.climb_motion import joint_names
from climbplan.exports.gains import read_gains
from climbplan.simulation.regulator import regulator_tables, zero_angles

TABLES, CODE = "regulator.npz", "joint_regulator.py"
_TICKS = 2000  # that are timed


class TickTime(NamedTuple):
    """What ticks take on this machine [s]."""

    median: float
    most: float  # of 99 in 100


def write_regulator(path: Path, gains: str | None, directory: Path) -> TickTime:
    """Write code and tables of a climb's regulator into a directory, and time it.

    gains: a number [N m/rad] or a file, the robot's if None. Raises UsageError for gains that
    cannot be and robots with five-bar legs or grippers, PlanFileError for what is no climb's plan.
    """
    plan = read_climb(path)
    robot = plan.robot
    if robot.gripper is not None or robot.sole is not None or zero_angles(robot) is None:
        raise UsageError(
            f"--format regulator: {robot.name} has five-bar legs, grippers or flat feet; the "
            "regulator knows "
            "limbs whose joints move one after the other and toes that press"
        )
    names = joint_names(robot)
    gain = None
    if gains is not None:
        gain = np.broadcast_to(robot.joint_stiffness, robot.has_joint.shape).copy()
        gain[robot.has_joint] = read_gains(
            gains, names, tuple(robot.slides[robot.has_joint].tolist())
        )
    tables = regulator_tables(plan, gain)
    table = {f.name: getattr(tables, f.name) for f in fields(RegulatorTables)}
    np.savez_compressed(directory / TABLES, joint_names=_placed(names, robot.has_joint), **table)
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


def _placed(names: tuple[str, ...], there: NDArray[np.bool_]) -> NDArray[np.str_]:
    """(N, J) names, empty where a limb has no such joint."""
    placed = np.full(there.shape, "", dtype=f"<U{max(map(len, names))}")
    placed[there] = names
    return placed
