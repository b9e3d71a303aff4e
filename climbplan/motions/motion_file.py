"""Motions as NPZ files in the layout that motion-tracking pipelines read.

The seven arrays that the published loaders read (`KEYS`) have their names, shapes and dtypes.
Others stand beside them: names, contacts with forces, torques, limits, terrain, verification. The
page on motions for learning describes all of them and names the versions that were read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.motions.link_tree import JointBounds
from climbplan.motions.tracked_motion import (
    ContactSamples,
    LinkArrays,
    Surfaces,
    TerrainMesh,
    TrackedMotion,
    number_names,
)
from climbplan.reading import DAMAGE, read_text, reading
from climbplan.store.atomic_file import replace_atomically

FORMAT, VERSION = "climbplan/tracked-motion", 1
KEYS = {  # of the published loaders: field of the motion, and axes; J joints, B bodies
    "joint_pos": ("joint_position", "TJ"),
    "joint_vel": ("joint_velocity", "TJ"),
    "body_pos_w": ("body_position", "TB3"),
    "body_quat_w": ("body_quaternion", "TB4"),
    "body_lin_vel_w": ("body_velocity", "TB3"),
    "body_ang_vel_w": ("body_angular_velocity", "TB3"),
}
COMPANION = "meta.json"  # beside files of some tools
_MAX_COMPANION = 1_000_000  # [bytes]
_ARCHIVES, _NPY = (b"PK\x03\x04", b"PK\x05\x06"), b"\x93NUMPY"  # how files begin
_EXPECTED = "an NPZ file of a motion"
_EXPORT_HINT = "`climbplan export PLAN --format motion` writes that of a plan"
_FREE_POSITIONS = 7  # position and quaternion of a free joint
_LIMITS = "joint_limit_"  # start of the keys of limits, which may be infinite
_NORM_TOLERANCE = 1e-2  # of quaternions


def name_terrain_file(path: Path) -> Path:
    """Return the mesh file of the terrain of a motion file: `motion.terrain.obj`."""
    return path.with_name(f"{path.stem}.terrain.obj")


def write_motion_file(motion: TrackedMotion, path: Path) -> None:
    """Write a motion, and its terrain as an OBJ mesh beside it; no pickles.

    Raises UsageError if a file cannot be written.
    """
    whole_rate = float(motion.fps).is_integer()
    arrays: dict[str, NDArray[Any]] = {
        "fps": np.array([motion.fps], np.int64 if whole_rate else np.float64)
    }
    for key, (name, _) in KEYS.items():
        arrays[key] = np.asarray(getattr(motion, name), np.float32)
    arrays["joint_names"] = np.array(motion.joint_names)
    arrays["body_names"] = np.array(motion.body_names)
    for name in ("joint_command", "joint_torque"):
        if getattr(motion, name) is not None:
            arrays[name] = np.asarray(getattr(motion, name), np.float32)
    if motion.bounds is not None:
        arrays |= {
            f"joint_limit_{name}": np.asarray(values, np.float32)
            for name, values in vars(motion.bounds).items()
        }
    if motion.contacts is not None:
        arrays |= _list_contact_arrays(motion.contacts)
    if motion.surfaces is not None:
        arrays["surface_names"] = np.array(motion.surfaces.names)
        arrays["surface_friction"] = np.asarray(motion.surfaces.friction, np.float32)
    if motion.terrain is not None:
        arrays["terrain_mesh"] = np.array(name_terrain_file(path).name)
        arrays["terrain_pos"] = np.zeros(3, np.float32)
        arrays["terrain_quat"] = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
        _write_mesh(motion.terrain, name_terrain_file(path))
    if motion.is_verified is not None:
        arrays["verified"] = np.array(motion.is_verified)
    facts = {
        "format": FORMAT,
        "version": VERSION,
        "name": motion.name,
        "notes": list(motion.notes),
        **motion.facts,
    }
    arrays["facts"] = np.array(json.dumps(facts, allow_nan=False))
    with replace_atomically(path) as temporary_path, temporary_path.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _list_contact_arrays(contacts: ContactSamples) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {
        "contact": contacts.is_touching,
        "contact_names": np.array(contacts.names),
        "contact_body": np.asarray(contacts.body, np.int32),
        "contact_offset": np.asarray(contacts.offset, np.float32),
        "contact_radius": np.asarray(contacts.radius, np.float32),
        "contact_surface": np.asarray(contacts.surface, np.int32),
        "contact_position": np.asarray(contacts.position, np.float32),
        "contact_normal": np.asarray(contacts.normal, np.float32),
        "contact_grips": np.array(contacts.is_gripping),
    }
    if contacts.moment is not None:
        arrays["contact_moment"] = np.asarray(contacts.moment, np.float32)
    if contacts.force is not None:
        arrays["contact_force"] = np.asarray(contacts.force, np.float32)
    return arrays


def _write_mesh(mesh: TerrainMesh, path: Path) -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()]
    with replace_atomically(path) as temporary_path:
        temporary_path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_motion_file(path: Path) -> TrackedMotion:
    """Read a motion, own or foreign; arrays that a foreign file lacks are None.

    Raises:
        UsageError: It is no such file; with the key, and what was expected.
    """
    if path.is_dir():
        raise UsageError(f"{path}: a directory, expected {_EXPECTED}; {_EXPORT_HINT}")
    with reading(path, _EXPECTED, damage=(*DAMAGE, BadZipFile)), path.open("rb") as stream:
        _check_signature(path, stream.read(len(_NPY)))
        stream.seek(0)
        stored = np.load(stream, allow_pickle=False)
        if isinstance(stored, np.ndarray):
            raise UsageError(f"{path}: one array, expected {_EXPECTED}")
        with stored:
            arrays = {name: stored[name] for name in stored.files}
    arrays = {**_read_companion(path), **arrays}
    links = _read_published_arrays(path, arrays)
    joints, bodies = links.joint_position.shape[1], links.body_position.shape[1]
    reader = _ExtraArrays(path, arrays, len(links.joint_position))
    return TrackedMotion(
        name=path.stem,
        fps=_read_rate(path, arrays),
        joint_names=reader.read_names("joint_names", joints, "joint"),
        body_names=reader.read_names("body_names", bodies, "body"),
        **vars(links),
        joint_command=reader.read_numbers("joint_command", (reader.samples, joints)),
        joint_torque=reader.read_numbers("joint_torque", (reader.samples, joints), may_be_nan=True),
        bounds=reader.read_bounds(joints),
        contacts=reader.read_contacts(bodies),
        surfaces=reader.read_surfaces(),
        terrain=_read_terrain(path, arrays),
        is_verified=reader.read_flag("verified"),
        facts=_read_facts(path, arrays),
    )


def _check_signature(path: Path, start: bytes) -> None:
    """Raise UsageError for files that are no archive; NumPy would advise to unpickle them."""
    if start and not start.startswith((*_ARCHIVES, _NPY)):
        raise UsageError(f"{path}: not {_EXPECTED}; {_EXPORT_HINT}")


def _read_companion(path: Path) -> dict[str, NDArray[Any]]:
    """Return rate and names from the `meta.json` beside a file, in which some tools have them."""
    companion = path.with_name(COMPANION)
    if not companion.is_file():
        return {}
    expected = "a JSON object with fps, joint_names and body_names"
    text = read_text(companion, _MAX_COMPANION, expected)
    with reading(companion, expected):
        values = json.loads(text)
    if not isinstance(values, dict):
        raise UsageError(f"{companion}: expected {expected}")
    kinds = {"fps": "fiu", "joint_names": "U", "body_names": "U"}
    out = {key: np.array(values[key]) for key in kinds if key in values}
    for key, array in out.items():
        if array.dtype.kind not in kinds[key]:
            what = "a rate [Hz]" if key == "fps" else "a list of names"
            raise UsageError(f"{companion}: {key}: expected {what}")
    return out


def _read_rate(path: Path, arrays: Mapping[str, NDArray[Any]]) -> float:
    """Return the sample rate [Hz], which files have as a number or as an array of one."""
    if "fps" not in arrays:
        raise UsageError(f"{path}: fps: missing, expected one rate > 0 Hz, here or in {COMPANION}")
    values = arrays["fps"]
    if values.size != 1 or values.dtype.kind not in "fiu" or not 0 < float(values.flat[0]) < 1e6:
        raise UsageError(f"{path}: fps: expected one rate > 0 Hz")
    return float(values.flat[0])


def _read_published_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> LinkArrays:
    """Return the six arrays of samples; raises UsageError for wrong keys and shapes."""
    missing = [key for key in KEYS if key not in arrays]
    if missing:
        present = ", ".join(sorted(arrays)) or "nothing"
        raise UsageError(
            f"{path}: no {', '.join(missing)}; expected the keys fps, {', '.join(KEYS)}, "
            f"got {present}"
        )
    arrays = _drop_free_joint(arrays)
    lengths: dict[str, int] = {"3": 3, "4": 4}
    out = {}
    for key, (name, axes) in KEYS.items():
        values = arrays[key]
        if values.dtype.kind not in "fiu" or values.ndim != len(axes):
            raise UsageError(f"{path}: {key}: expected numbers of shape ({', '.join(axes)})")
        for axis, length in zip(axes, values.shape, strict=True):
            if lengths.setdefault(axis, length) != length:
                raise UsageError(
                    f"{path}: {key}: shape {values.shape}, expected ({', '.join(axes)}) with "
                    f"{axis} = {lengths[axis]}"
                )
        out[name] = np.asarray(values, float)
        if not np.isfinite(out[name]).all():
            raise UsageError(f"{path}: {key}: NaN or infinite, expected finite numbers")
    if lengths["T"] < 2 or lengths["B"] < 1:
        raise UsageError(f"{path}: expected 2 samples and 1 body or more")
    norm = np.linalg.norm(out["body_quaternion"], axis=-1)
    if np.abs(norm - 1).max() > _NORM_TOLERANCE:
        raise UsageError(
            f"{path}: body_quat_w: norm {norm.flat[np.abs(norm - 1).argmax()]:.3g}, "
            "expected unit quaternions w, x, y, z"
        )
    return LinkArrays(**out)


def _drop_free_joint(arrays: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    """Return arrays without the root's free joint, where joints begin with it.

    Some tools store all coordinates of MuJoCo: 7 of position and 6 of velocity come first.
    """
    position, velocity = arrays["joint_pos"], arrays["joint_vel"]
    has_free_joint = (
        position.ndim == velocity.ndim == 2
        and position.shape[1] == velocity.shape[1] + 1
        and position.shape[1] >= _FREE_POSITIONS
    )
    if not has_free_joint:
        return arrays
    return {
        **arrays,
        "joint_pos": position[:, _FREE_POSITIONS:],
        "joint_vel": velocity[:, _FREE_POSITIONS - 1 :],
    }


class _ExtraArrays:
    """The arrays beside those of the published layout, each checked for its shape."""

    def __init__(self, path: Path, arrays: Mapping[str, NDArray[Any]], samples: int) -> None:
        self.path, self.arrays, self.samples = path, arrays, samples

    def read_numbers(
        self, key: str, shape: tuple[int, ...], may_be_nan: bool = False
    ) -> Array | None:
        """Return an array of a shape; -1 stands for any length. None where there is none."""
        if key not in self.arrays:
            return None
        values = self.arrays[key]
        fits = values.ndim == len(shape) and all(
            want in (-1, length) for want, length in zip(shape, values.shape, strict=True)
        )
        if not fits or values.dtype.kind not in "fiub":
            raise UsageError(
                f"{self.path}: {key}: {values.dtype} of shape {values.shape}, expected numbers of "
                f"shape {shape}"
            )
        numbers = np.asarray(values, float)
        if np.isnan(numbers).any() and not may_be_nan:
            raise UsageError(f"{self.path}: {key}: NaN in it, expected numbers")
        if np.isinf(numbers).any() and not key.startswith(_LIMITS):
            raise UsageError(f"{self.path}: {key}: infinite numbers, expected finite ones")
        return numbers

    def read_nonnegative(self, key: str, shape: tuple[int, ...]) -> Array | None:
        """Return an array of numbers >= 0, as `read_numbers`."""
        numbers = self.read_numbers(key, shape)
        if numbers is not None and (numbers < 0).any():
            raise UsageError(f"{self.path}: {key}: {numbers.min():g}, expected numbers >= 0")
        return numbers

    def read_flag(self, key: str) -> bool | None:
        """Return a truth value; None where there is none."""
        if key not in self.arrays:
            return None
        values = self.arrays[key]
        if values.size != 1 or values.dtype.kind not in "biu":
            raise UsageError(
                f"{self.path}: {key}: {values.dtype} of shape {values.shape}, expected one bool"
            )
        return bool(values.flat[0])

    def require_numbers(self, key: str, shape: tuple[int, ...]) -> Array:
        """Return an array that has to be there, as `read_numbers`."""
        numbers = self.read_numbers(key, shape)
        if numbers is None:
            raise UsageError(f"{self.path}: {key}: missing, expected shape {shape} with `contact`")
        return numbers

    def read_names(self, key: str, count: int, what: str) -> tuple[str, ...]:
        """Return names, or numbered ones where the file has none."""
        if key not in self.arrays:
            return number_names(what, count)
        names = tuple(str(name) for name in np.atleast_1d(self.arrays[key]).tolist())
        if len(names) != count:
            raise UsageError(f"{self.path}: {key}: {len(names)} names, expected {count}")
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise UsageError(f"{self.path}: {key}: {repeated[0]!r} twice, expected unique names")
        return names

    def read_bounds(self, joints: int) -> JointBounds | None:
        """Return the limits of joints; None where the file has none."""
        keys = [f"{_LIMITS}{name}" for name in JointBounds.__dataclass_fields__]
        values = [self.read_numbers(key, (joints,)) for key in keys]
        present = [value for value in values if value is not None]
        if not present:
            return None
        if len(present) < len(values):
            absent = next(key for key, value in zip(keys, values, strict=True) if value is None)
            raise UsageError(f"{self.path}: {absent}: missing, expected all of {', '.join(keys)}")
        bounds = JointBounds(*present)
        if (bounds.lower > bounds.upper).any():
            raise UsageError(f"{self.path}: joint_limit_lower: expected at most joint_limit_upper")
        if not (bounds.speed > 0).all() or not (bounds.torque > 0).all():
            raise UsageError(f"{self.path}: joint_limit_speed and _torque: expected numbers > 0")
        return bounds

    def read_surfaces(self) -> Surfaces | None:
        """Return names and friction of surfaces; None where the file has none."""
        friction = self.read_nonnegative("surface_friction", (-1,))
        if friction is None:
            return None
        return Surfaces(self.read_names("surface_names", len(friction), "surface"), friction)

    def read_contacts(self, bodies: int) -> ContactSamples | None:
        """Return contacts; None where the file has none. Forces may be missing."""
        touching = self.read_numbers("contact", (self.samples, -1))
        if touching is None or not touching.shape[1]:
            return None
        count = touching.shape[1]
        body = self.require_numbers("contact_body", (count,)).astype(np.int64)
        if len(body) and not (body.min() >= 0 and body.max() < bodies):
            raise UsageError(f"{self.path}: contact_body: expected indices of {bodies} bodies")
        friction = self.read_numbers("surface_friction", (-1,))
        surface = self.read_numbers("contact_surface", (self.samples, count))
        surfaces = np.full(touching.shape, -1) if surface is None else surface.astype(np.int64)
        if surfaces.max(initial=-1) >= (0 if friction is None else len(friction)):
            raise UsageError(f"{self.path}: contact_surface: expected indices of surface_friction")
        offset = self.require_numbers("contact_offset", (count, -1, 3))
        if not offset.shape[1]:
            raise UsageError(f"{self.path}: contact_offset: expected 1 point of each foot or more")
        radius = self.read_nonnegative("contact_radius", (count,))
        vectors = (self.samples, count, 3)
        return ContactSamples(
            names=self.read_names("contact_names", count, "contact"),
            body=body,
            offset=offset,
            radius=np.zeros(count) if radius is None else radius,
            is_touching=touching > 0,
            surface=surfaces,
            force=self.read_numbers("contact_force", vectors),
            position=self.require_numbers("contact_position", vectors),
            normal=self.require_numbers("contact_normal", vectors),
            moment=self.read_numbers("contact_moment", vectors),
            is_gripping=bool(self.read_flag("contact_grips")),
        )


def _read_terrain(path: Path, arrays: Mapping[str, NDArray[Any]]) -> TerrainMesh | None:
    """Return the mesh that a file names, which stands beside it, at its pose in the world."""
    if "terrain_mesh" not in arrays:
        return None
    name = str(arrays["terrain_mesh"])
    if arrays["terrain_mesh"].size != 1 or Path(name).name != name or not name:
        raise UsageError(f"{path}: terrain_mesh: {name!r}, expected the name of a file beside it")
    mesh = read_terrain_mesh(path.with_name(name))
    reader = _ExtraArrays(path, arrays, 0)
    position = reader.read_numbers("terrain_pos", (3,))
    quaternion = reader.read_numbers("terrain_quat", (4,))
    vertices = mesh.vertices
    if quaternion is not None:
        if abs(np.linalg.norm(quaternion) - 1) > _NORM_TOLERANCE:
            raise UsageError(f"{path}: terrain_quat: expected a unit quaternion w, x, y, z")
        vertices = Rotation.from_quat(quaternion[[1, 2, 3, 0]]).apply(vertices)
    return TerrainMesh(vertices if position is None else vertices + position, mesh.faces)


def read_terrain_mesh(path: Path) -> TerrainMesh:
    """Read a triangle mesh (OBJ, STL, PLY and others); raises UsageError if there is none."""
    from climbplan.scan.meshes import read_mesh
    from climbplan.scan.raw import ScanError

    try:
        scan = read_mesh(path)
    except ScanError as error:
        raise UsageError(str(error)) from error
    if not len(scan.triangles):
        raise UsageError(f"{path}: no triangles in it, expected a mesh of the terrain")
    return TerrainMesh(scan.vertices, scan.triangles)


def _read_facts(path: Path, arrays: Mapping[str, NDArray[Any]]) -> dict[str, object]:
    if "facts" not in arrays:
        return {}
    with reading(path, "facts in JSON"):
        facts = json.loads(str(arrays["facts"]))
    if not isinstance(facts, dict):
        raise UsageError(f"{path}: facts: expected a JSON object")
    return facts
