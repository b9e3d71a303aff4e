"""The motion that `climbplan export --format csv` writes, read back by its documented names."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError

MOTION_CSV, MOTION_JSON = "motion.csv", "motion.csv.json"
_FORMAT, _VERSION = "climbplan/motion", 1


@dataclass(frozen=True)
class ExportedJoint:
    """A motor and its controller; of joints that slide N for N m and m for rad."""

    name: str  # of the URDF
    limb: str
    slides: bool
    gain: float  # P gain of the commands in the file [N m/rad]
    damping: float  # D gain [N m s/rad]
    max_torque: float  # [N m]


@dataclass(frozen=True)
class ExportedContact:
    """The point of a limb that is to touch the terrain."""

    name: str  # of the limb
    link: str  # of the URDF
    offset: tuple[float, float, float]  # in the frame of that link [m]
    radius: float  # of a spherical foot about that point, 0 of a point [m]


@dataclass(frozen=True)
class ExportedMotion:
    """T samples of J joints and C contacts, world frame, SI units, motor signs."""

    name: str
    robot: str
    base_link: str
    time: Array  # (T,) [s]
    base_position: Array  # (T, 3) of the URDF's root link [m]
    base_quaternion: Array  # (T, 4) x, y, z, w; link to world
    joints: tuple[ExportedJoint, ...]
    command: Array  # (T, J) of the P controller [rad]
    angle: Array  # (T, J) planned [rad]
    effort: Array  # (T, J) added to the P controller [N m]
    torque: Array  # (T, J) planned against contact forces [N m]
    gravity: Array  # (T, J) added to hold the links [N m]
    contacts: tuple[ExportedContact, ...]
    force: Array  # (T, C, 3) planned, on the robot [N]
    touching: BoolArray  # (T, C) planned contact
    held: dict[str, float]  # joint name -> angle at which it is locked [rad]

    @property
    def total_torque(self) -> Array:
        """(T, J) that motors are planned to bring [N m]."""
        return self.torque + self.gravity

    def index_at(self, time: float) -> int:
        """Return the last sample that is not after a time [s]."""
        index = int(np.searchsorted(self.time, time + 1e-9, side="right")) - 1
        return min(max(index, 0), len(self.time) - 1)


def read_motion(directory: Path) -> ExportedMotion:
    """Read `motion.csv` and `motion.csv.json` of a directory.

    Raises UsageError for files of another format and for robots without a URDF.
    """
    facts = json.loads((directory / MOTION_JSON).read_text(encoding="utf-8"))
    if (facts.get("format"), facts.get("version")) != (_FORMAT, _VERSION):
        raise UsageError(
            f"{directory / MOTION_JSON}: expected {_FORMAT} version {_VERSION}, "
            f"got {facts.get('format')!r} version {facts.get('version')!r}"
        )
    if not facts.get("base_link"):
        raise UsageError(
            f"--engine drake: {facts['robot']} is not from a URDF; the second engine plays a plan "
            "on the robot's own URDF, so plan it with a robot file that has `urdf:`"
        )
    columns = _read_columns(directory / MOTION_CSV)
    joints = tuple(_read_joint(entry) for entry in facts["joints"])
    contacts = tuple(
        ExportedContact(c["name"], c["link"], tuple(c["offset"]), c["radius"])
        for c in facts["contacts"]
    )

    def of_joints(quantity: str, turning: str, sliding: str) -> Array:
        names = [f"{j.name}_{quantity}_{sliding if j.slides else turning}" for j in joints]
        return np.stack([columns[name] for name in names], axis=1)

    def vectors(names: list[str], unit: str) -> Array:
        component_columns = [[columns[f"{n}_{axis}_{unit}"] for axis in "xyz"] for n in names]
        return np.moveaxis(np.array(component_columns), -1, 0)

    limbs = [c.name for c in contacts]
    quaternion = [columns[f"base_{component}"] for component in ("qx", "qy", "qz", "qw")]
    return ExportedMotion(
        name=facts["name"],
        robot=facts["robot"],
        base_link=facts["base_link"],
        time=columns["time_s"],
        base_position=vectors(["base"], "m")[:, 0],
        base_quaternion=np.stack(quaternion, axis=1),
        joints=joints,
        command=of_joints("position", "rad", "m"),
        angle=of_joints("angle", "rad", "m"),
        effort=of_joints("effort", "Nm", "N"),
        torque=_read_torques(columns, joints),
        gravity=of_joints("gravity", "Nm", "N"),
        contacts=contacts,
        force=vectors([f"{limb}_force" for limb in limbs], "N"),
        touching=np.stack([columns[f"{limb}_contact"] for limb in limbs], axis=1) > 0.5,
        held={name: float(angle) for name, angle in facts.get("held_joints", {}).items()},
    )


def _read_joint(entry: dict[str, Any]) -> ExportedJoint:
    return ExportedJoint(
        entry["name"],
        entry["limb"],
        entry["kind"] == "slides",
        entry["gain"],
        entry["damping"],
        entry["max_torque"],
    )


def _read_torques(columns: dict[str, Array], joints: tuple[ExportedJoint, ...]) -> Array:
    names = [f"{j.name}_force_N" if j.slides else f"{j.name}_torque_Nm" for j in joints]
    return np.stack([columns[name] for name in names], axis=1)


def _read_columns(path: Path) -> dict[str, Array]:
    with path.open(encoding="utf-8", newline="") as stream:
        header = next(csv.reader(stream))
        table = np.loadtxt(stream, delimiter=",", ndmin=2)
    return {name: table[:, index] for index, name in enumerate(header)}
