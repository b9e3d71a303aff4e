"""Public motions of other tools: poses of the root link and joint positions, read from files.

A YAML file lists where they are. Paths start from its folder:

    sources:
      - name: LAFAN1 on G1            # as tables name it
        source: github.com/OWNER/NAME
        commit: 0123abc
        files: g1/*.csv
        format: csv                   # or frames
        fps: 30                       # of csv
        robot: g1.urdf
        root_offset: [0, 0, 0]        # of the root link from the point of the file, its frame [m]
        joints: [...]                 # in the order of the files; left out: depth first
        feet: [left_ankle_roll_link, right_ankle_roll_link]

`csv`: a row a sample with x, y, z, the quaternion x, y, z, w and joint positions. `frames`: JSON
with `FrameDuration` [s] and `Frames`, lists that begin with the same numbers.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.errors import SpecError, UsageError
from climbplan.motions.link_tree import RobotFile
from climbplan.motions.tracked_motion import TrackedMotion, compute_quaternions
from climbplan.reading import DAMAGE, read_text, reading
from climbplan.schema.base import SpecModel, Vector
from climbplan.schema.kinds import validate
from climbplan.schema.yaml_source import parse_yaml

_ROOT_NUMBERS = 7  # of position and quaternion
_MAX_BYTES = 1_000_000  # of the list


class PublicSource(SpecModel):
    """Motions of one robot from one repository."""

    name: str
    source: str
    commit: str
    files: str
    format: Literal["csv", "frames"] = "csv"
    fps: float | None = None
    robot: str
    root_offset: Vector = (0.0, 0.0, 0.0)
    joints: tuple[str, ...] | None = None
    feet: tuple[str, ...]


class PublicSources(SpecModel):
    """All public motions of a run."""

    sources: tuple[PublicSource, ...]


def read_sources(path: Path) -> tuple[PublicSource, ...]:
    """Read the list of public motions; raises SpecError with all mistakes in it."""
    document = parse_yaml(read_text(path, _MAX_BYTES, "a list of motions in YAML"), str(path))
    sources, findings = validate(document, PublicSources)
    if sources is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return sources.sources


def list_files(source: PublicSource, folder: Path) -> list[Path]:
    """Return the files of a source; raises UsageError where there are none."""
    files = sorted(folder.glob(source.files))
    if not files:
        raise UsageError(f"{folder / source.files}: no files")
    return files


def read_public_motion(path: Path, source: PublicSource, robot: RobotFile) -> TrackedMotion:
    """Read a motion, whose links follow by forward kinematics; velocities are differences.

    Raises:
        UsageError: The file holds something else.
    """
    expected = f"samples of the root's pose and joints, as {source.format}"
    with reading(path, expected, damage=(*DAMAGE, LookupError, ZeroDivisionError)):
        rows, fps = _read_rows(path, source)
    names = source.joints or robot.links.joint_names
    if rows.shape[1] < _ROOT_NUMBERS + len(names) or len(rows) < 2:
        raise UsageError(f"{path}: expected samples of {_ROOT_NUMBERS + len(names)} numbers")
    joints = np.zeros((len(rows), len(robot.links.joint_names)))
    for column, name in enumerate(names):
        joints[:, robot.links.joint_names.index(name)] = rows[:, _ROOT_NUMBERS + column]
    rotation = Rotation.from_quat(rows[:, 3:_ROOT_NUMBERS]).as_matrix()
    position = rows[:, :3] + rotation @ np.array(source.root_offset)
    poses = robot.links.compute_poses(position, rotation, joints)
    return TrackedMotion(
        name=path.stem,
        fps=fps,
        joint_names=robot.links.joint_names,
        body_names=robot.links.link_names,
        joint_position=joints,
        joint_velocity=np.asarray(np.gradient(joints, 1 / fps, axis=0)),
        body_position=poses.position,
        body_quaternion=compute_quaternions(poses.rotation),
        body_velocity=np.asarray(np.gradient(poses.position, 1 / fps, axis=0)),
        body_angular_velocity=_differentiate_rotations(poses.rotation, fps),
    )


def _read_rows(path: Path, source: PublicSource) -> tuple[Array, float]:
    """Return samples (T, numbers) and their rate [Hz]."""
    if source.format == "csv":
        if source.fps is None:
            raise UsageError(f"{source.name}: expected fps, which csv files lack")
        return np.loadtxt(path, delimiter=",", ndmin=2), source.fps
    content = json.loads(path.read_text(encoding="utf-8"))
    return np.array(content["Frames"], float), 1 / float(content["FrameDuration"])


def _differentiate_rotations(rotation: Array, fps: float) -> Array:
    """Return angular velocities (T, B, 3) of rotations (T, B, 3, 3), world frame [rad/s]."""
    last = len(rotation) - 1
    before, after = np.maximum(np.arange(-1, last), 0), np.minimum(np.arange(1, last + 2), last)
    turn = rotation[after] @ np.swapaxes(rotation[before], -1, -2)
    vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vector.reshape(turn.shape[:-1]) * (fps / (after - before))[:, None, None])
