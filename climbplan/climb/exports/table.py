"""A climb's samples as planned, as CSV for a robot or another simulator."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from climbplan.climb.exports.motion import build_motion
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.exports.motion import RobotMotion
from climbplan.exports.sidecar import write_sidecar
from climbplan.exports.tables import BASE, POSE
from climbplan.store.csv_file import write_csv

_BODY = ("com_x_m", "com_y_m", "com_z_m", "roll_rad", "pitch_rad", "yaw_rad")


def export_csv(path: Path, out: Path | TextIO) -> None:
    """Write the trajectory of a plan file as CSV with one header line that names the units.

    Columns: time, body position and roll, pitch, yaw (world; R = Rz Ry Rx), joint commands of every
    limb, contact of each limb as 0 or 1; then the pose of the URDF's root link where there is one,
    motor torques against contact forces and against the links' weight, and contact forces. Numbers
    keep their full precision. A file at `out` is replaced whole or not at all, and frames, signs
    and gains stand in a JSON file beside it; a stream is written to.

    Raises:
        PlanFileError: The file is not a climb plan.
        UsageError: `out` cannot be written.
    """
    plan = read_climb(path)
    motion = build_motion(plan)
    write_csv(out, _build_header(motion), _generate_rows(plan, motion))
    if isinstance(out, Path):
        write_sidecar(motion, out)


def _build_header(motion: RobotMotion) -> list[str]:
    """Return the column names with units."""
    joints, contacts = motion.joints, motion.contacts
    assert joints is not None
    assert contacts is not None
    units = ["m" if joints.is_sliding(j) else "rad" for j in range(len(joints.names))]
    forces = ["N" if joints.is_sliding(j) else "Nm" for j in range(len(joints.names))]
    efforts = list(zip(joints.names, forces, strict=True))
    return [
        "time_s",
        *_BODY,
        *(f"{name}_{unit}" for name, unit in zip(joints.names, units, strict=True)),
        *(f"{limb}_contact" for limb in contacts.names),
        *(() if motion.base is None else (f"{BASE}_{component}" for component in POSE)),
        *(f"{name}_{'force' if unit == 'N' else 'torque'}_{unit}" for name, unit in efforts),
        *(f"{name}_gravity_{unit}" for name, unit in efforts),
        *(f"{limb}_force_{axis}_N" for limb in contacts.names for axis in "xyz"),
    ]


def _generate_rows(plan: ClimbPlan, motion: RobotMotion) -> Iterator[list[float | int]]:
    """Yield the rows, one per sample."""
    trajectory, base, joints, contacts = (
        plan.trajectory,
        motion.base,
        motion.joints,
        motion.contacts,
    )
    assert joints is not None
    assert contacts is not None
    pose = np.zeros((len(trajectory.time), 0))
    if base is not None:
        pose = np.hstack([base.position, base.quaternion])
    for sample in range(len(trajectory.time)):
        yield [
            float(trajectory.time[sample]),
            *trajectory.com[sample].tolist(),
            *trajectory.rpy[sample].tolist(),
            *joints.command[sample].tolist(),
            *(int(is_touching) for is_touching in trajectory.contact[sample]),
            *pose[sample].tolist(),
            *joints.torque[sample].tolist(),
            *joints.gravity[sample].tolist(),
            *contacts.force[sample].ravel().tolist(),
        ]
