"""The playable motion as CSV for a robot or another simulator."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.plans.csv_file import write_csv
from climbplan.robots.model import Robot

_BODY = ("com_x_m", "com_y_m", "com_z_m", "roll_rad", "pitch_rad", "yaw_rad")


def export_csv(path: Path, out: Path | TextIO) -> None:
    """Write the trajectory of a plan file as CSV with one header line that names the units.

    Columns: time, body position and roll, pitch, yaw (world), joint commands of every limb, contact
    of each limb as 0 or 1. Numbers keep their full precision. A file at `out` is replaced whole or
    not at all; a stream is written to. Raises PlanFileError for a file that is not a climb plan
    and UsageError if `out` cannot be written.
    """
    plan = read_climb(path)
    write_csv(out, _header(plan.robot), _rows(plan))


def _header(robot: Robot) -> list[str]:
    names = zip(robot.limb_names, robot.limbs.joint_names, robot.slides, strict=True)
    joints = [
        f"{limb}_{joint}_{'m' if is_sliding else 'rad'}"
        for limb, own, slides in names
        for joint, is_sliding in zip(own, slides, strict=True)
        if joint
    ]
    return ["time_s", *_BODY, *joints, *(f"{limb}_contact" for limb in robot.limb_names)]


def _rows(plan: ClimbPlan) -> Iterator[list[float | int]]:
    trajectory = plan.trajectory
    there = plan.robot.has_joint
    for sample in range(len(trajectory.time)):
        yield [
            float(trajectory.time[sample]),
            *trajectory.com[sample].tolist(),
            *trajectory.rpy[sample].tolist(),
            *trajectory.joint_command[sample][there].tolist(),
            *(int(touches) for touches in trajectory.contact[sample]),
        ]
