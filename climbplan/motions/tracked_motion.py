"""A motion as arrays at a fixed rate, in the layout of motion-tracking pipelines, with contacts.

Frames are those of the world, z up. Quaternions are w, x, y, z, link to world. Velocities are those
of the links' frames, not of their centres of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.exports.motion import unwrap_quaternions
from climbplan.motions.link_tree import JointBounds

DIFFERENCE_STEP = 1e-4  # [s] of the difference quotients that give velocities
DEFAULT_RATE = 50.0  # [Hz], of the published converters
MAX_RATE = 2000.0  # [Hz]
MAX_SAMPLES = 500_000


@dataclass(frozen=True)
class ContactSamples:
    """C places of the robot that may touch, at T samples; world frame, forces on the robot."""

    names: tuple[str, ...]  # (C,)
    body: IntArray  # (C,) index of the link that carries each
    offset: Array  # (C, K, 3) its K points in the frame of that link [m]
    radius: Array  # (C,) of spheres about the points [m]; 0: the points themselves touch
    is_touching: BoolArray  # (T, C)
    surface: IntArray  # (T, C) index in the surfaces; -1 in the air
    force: Array | None  # (T, C, 3) [N]; None: unknown
    position: Array  # (T, C, 3) where it touches, or would [m]
    normal: Array  # (T, C, 3) unit, into free space; zero in the air
    moment: Array | None = None  # (T, C, 3) of soles, about `position` [N m]
    is_gripping: bool = False  # so that normal forces may pull


@dataclass(frozen=True)
class TerrainMesh:
    """Triangles of the terrain, anticlockwise seen from free space."""

    vertices: Array  # (V, 3) [m]
    faces: IntArray  # (F, 3)

    @property
    def corners(self) -> Array:
        """Corners (F, 3, 3) of all triangles [m]."""
        return np.asarray(self.vertices[self.faces])


@dataclass(frozen=True)
class Surfaces:
    """R surfaces that toes stand on."""

    names: tuple[str, ...]
    friction: Array  # (R,)


@dataclass(frozen=True)
class TrackedMotion:
    """T samples of J joints and B links; what is None is not known."""

    name: str
    fps: float  # [Hz]
    joint_names: tuple[str, ...]  # (J,)
    body_names: tuple[str, ...]  # (B,)
    joint_position: Array  # (T, J) [rad], [m] of sliding joints
    joint_velocity: Array  # (T, J)
    body_position: Array  # (T, B, 3) [m]
    body_quaternion: Array  # (T, B, 4) w, x, y, z
    body_velocity: Array  # (T, B, 3) [m/s]
    body_angular_velocity: Array  # (T, B, 3) [rad/s]
    joint_command: Array | None = None  # (T, J) for P controllers of the robot's gains [rad]
    joint_torque: Array | None = None  # (T, J) of motors [N m]; NaN of joints without a value
    bounds: JointBounds | None = None
    contacts: ContactSamples | None = None
    surfaces: Surfaces | None = None
    terrain: TerrainMesh | None = None
    is_verified: bool | None = None
    notes: tuple[str, ...] = ()  # what users of the file have to know
    facts: Mapping[str, object] = field(default_factory=dict)

    @property
    def time(self) -> Array:
        """(T,) from the first sample [s]."""
        return np.asarray(np.arange(len(self.joint_position)) / self.fps)

    @property
    def body_rotation(self) -> Array:
        """(T, B, 3, 3) link to world."""
        quaternion = self.body_quaternion[..., [1, 2, 3, 0]]
        flat = Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix()
        return np.asarray(flat.reshape(*quaternion.shape[:-1], 3, 3))


@dataclass(frozen=True)
class LinkArrays:
    """Joints and links at T samples, under the names of `TrackedMotion`, where they are told."""

    joint_position: Array
    joint_velocity: Array
    body_position: Array
    body_quaternion: Array
    body_velocity: Array
    body_angular_velocity: Array


@dataclass(frozen=True)
class LinkStates:
    """Joints and links at M times, from which velocities are differenced."""

    joint_position: Array  # (M, J)
    body_position: Array  # (M, B, 3)
    body_rotation: Array  # (M, B, 3, 3)


def build_times(begin: float, end: float, rate: float | None) -> tuple[Array, float]:
    """Return evenly spaced times (T,) and their rate [Hz]; what is left of a period is dropped.

    Raises:
        UsageError: The rate is out of range, or the motion is shorter than one period.
    """
    fps = DEFAULT_RATE if rate is None else rate
    if not 0 < fps <= MAX_RATE:
        raise UsageError(f"--rate {fps:g}: expected more than 0 and at most {MAX_RATE:g} Hz")
    count = int(np.floor((end - begin) * fps * (1 + 1e-12))) + 1
    if not 2 <= count <= MAX_SAMPLES:
        raise UsageError(
            f"--rate {fps:g}: {count} samples of {end - begin:.3g} s, expected 2 to {MAX_SAMPLES}"
        )
    return begin + np.arange(count) / fps, fps


def differentiate_links(
    evaluate: Callable[[Array], LinkStates], time: Array, begin: float, end: float
) -> LinkArrays:
    """Return joints and links at times, with velocities.

    Velocities are difference quotients of the motion a little before and after each time, so that
    they do not depend on the sample rate.

    Args:
        evaluate: The motion as a function of times (M,) [s].
        time: (T,) [s].
        begin: First time of the motion [s]; quotients at its ends are one-sided.
        end: Last time of the motion [s].
    """
    before = np.maximum(time - DIFFERENCE_STEP, begin)
    after = np.minimum(time + DIFFERENCE_STEP, end)
    span = (after - before)[:, None]
    first, middle, last = (evaluate(times) for times in (before, time, after))
    turn = last.body_rotation @ np.swapaxes(first.body_rotation, -1, -2)
    rotation_vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec()
    angular = rotation_vector.reshape(turn.shape[:-1]) / span[..., None]
    return LinkArrays(
        joint_position=middle.joint_position,
        joint_velocity=(last.joint_position - first.joint_position) / span,
        body_position=middle.body_position,
        body_quaternion=compute_quaternions(middle.body_rotation),
        body_velocity=(last.body_position - first.body_position) / span[..., None],
        body_angular_velocity=angular,
    )


def compute_quaternions(rotation: Array) -> Array:
    """Return w, x, y, z (T, B, 4) of rotations (T, B, 3, 3), without jumps between samples."""
    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat()
    quaternion = flat.reshape(*rotation.shape[:-2], 4)
    unwrapped = [unwrap_quaternions(quaternion[:, b]) for b in range(rotation.shape[1])]
    return np.stack(unwrapped, axis=1)[..., [3, 0, 1, 2]]


def build_polygon_mesh(polygons: Sequence[Array], *meshes: TerrainMesh) -> TerrainMesh:
    """Return convex polygons (K, 3) as triangles, and further meshes with them."""
    fans = [
        TerrainMesh(p, np.array([[0, i, i + 1] for i in range(1, len(p) - 1)])) for p in polygons
    ]
    triangle_meshes = [*fans, *meshes]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in triangle_meshes[:-1])])
    return TerrainMesh(
        np.concatenate([mesh.vertices for mesh in triangle_meshes]),
        np.concatenate(
            [mesh.faces + start for mesh, start in zip(triangle_meshes, offsets, strict=True)]
        ),
    )


def number_names(what: str, count: int) -> tuple[str, ...]:
    """Return names for joints or bodies of a file that has none: "joint 0", "joint 1"."""
    return tuple(f"{what} {index}" for index in range(count))
