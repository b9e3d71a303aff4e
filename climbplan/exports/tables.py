"""A motion as CSV and as NumPy arrays."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.exports.motion import RobotMotion
from climbplan.exports.sidecar import collect_facts
from climbplan.store.atomic_file import replace_atomically
from climbplan.store.csv_file import write_csv

BASE = "base"  # in names of columns: the root link of the URDF, whatever its name
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def write_table(motion: RobotMotion, out: Path) -> None:
    """Write one row a sample: time, poses of bodies, joint commands, contacts and latches.

    Raises UsageError if the file cannot be written.
    """
    header, columns = ["time_s"], [motion.time[:, None]]
    for body in motion.bodies:
        header += [f"{body.name}_{coordinate}" for coordinate in POSE]
        columns += [body.position, body.quaternion]
    if motion.base is not None:
        header += [f"{BASE}_{coordinate}" for coordinate in POSE]
        columns += [motion.base.position, motion.base.quaternion]
    if motion.joints is not None:
        joints = motion.joints
        joint_columns: list[tuple[str, str, Array]] = [
            ("position_rad", "position_m", joints.command),
            ("velocity_rad_s", "velocity_m_s", joints.velocity),
            ("acceleration_rad_s2", "acceleration_m_s2", joints.acceleration),
            ("angle_rad", "angle_m", joints.angle),
            ("effort_Nm", "effort_N", joints.effort),
            ("torque_Nm", "force_N", joints.torque),
            ("gravity_Nm", "gravity_N", joints.gravity),
        ]
        for turning, sliding, values in joint_columns:
            header += [
                f"{name}_{sliding if joints.is_sliding(j) else turning}"
                for j, name in enumerate(joints.names)
            ]
            columns.append(values)
    if motion.contacts is not None:
        contacts = motion.contacts
        header += [f"{name}_point_{axis}_m" for name in contacts.names for axis in "xyz"]
        header += [f"{name}_force_{axis}_N" for name in contacts.names for axis in "xyz"]
        header += [f"{name}_contact" for name in contacts.names]
        columns += [
            contacts.point.reshape(len(motion.time), -1),
            contacts.force.reshape(len(motion.time), -1),
            contacts.touching.astype(float),
        ]
    if motion.latches is not None:
        latches = motion.latches
        header += [f"{end}_anchor" for end in latches.ends]
        places = latches.anchor_names[: latches.anchor_position.shape[1]]
        header += [f"{name}_{axis}_m" for name in places for axis in "xyz"]
        columns += [
            latches.anchor.astype(float),
            latches.anchor_position.reshape(len(motion.time), -1),
        ]
    write_csv(out, header, _iterate_rows(np.hstack(columns)))


def _iterate_rows(table: Array) -> Iterator[list[float]]:
    for row in table:
        yield row.tolist()


def write_arrays(motion: RobotMotion, out: Path) -> None:
    """Write an `.npz` of plain arrays under the names of this module's table; no pickles.

    Raises UsageError if the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {
        "time": motion.time,
        "words": np.array(motion.words),
        "facts": np.array(json.dumps(collect_facts(motion))),
    }
    for body in motion.bodies:
        arrays[f"body/{body.name}/position"] = body.position
        arrays[f"body/{body.name}/quaternion_xyzw"] = body.quaternion
    if motion.base is not None:
        arrays["base/position"] = motion.base.position
        arrays["base/quaternion_xyzw"] = motion.base.quaternion
        arrays["base/link"] = np.array(motion.base.name)
    if motion.joints is not None:
        joints = motion.joints
        arrays["joint/names"] = np.array(joints.names)
        arrays["joint/position"] = joints.command
        arrays["joint/velocity"] = joints.velocity
        arrays["joint/acceleration"] = joints.acceleration
        arrays["joint/effort"] = joints.effort
        arrays["joint/gravity"] = joints.gravity
        arrays["joint/torque"] = joints.torque
        arrays["joint/angle"] = joints.angle
        arrays["joint/gain"] = joints.gain
        if joints.limits is not None:
            arrays["joint/gain_rigid"] = joints.limits.rigid_gain
            arrays["joint/damping"] = joints.limits.damping
        if any(joints.slides):
            arrays["joint/slides"] = np.array(joints.slides)
    if motion.contacts is not None:
        contacts = motion.contacts
        arrays["contact/names"] = np.array(contacts.names)
        arrays["contact/point"] = contacts.point
        arrays["contact/force"] = contacts.force
        arrays["contact/touching"] = contacts.touching
    if motion.latches is not None:
        latches = motion.latches
        arrays["latch/ends"] = np.array(latches.ends)
        arrays["latch/anchor"] = latches.anchor
        arrays["latch/anchor_names"] = np.array(latches.anchor_names)
        arrays["latch/anchor_position"] = latches.anchor_position
    with replace_atomically(out) as temporary_path, temporary_path.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
