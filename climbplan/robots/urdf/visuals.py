"""Visual geometry of a robot from its URDF, with large meshes simplified."""

from __future__ import annotations

from collections import OrderedDict
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh

from climbplan.arrays import Array, IntArray
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.canonical_urdf import write_visual_urdf
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.shapes import find_carrying_joint
from climbplan.robots.visual_geometry import BODY, VisualGeometry
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults, parse_xml

MAX_TRIANGLES = 5000  # of one shape of a link


class VisualGeometryError(Exception):
    """Visual geometry that is missing or cannot be read; the message says which."""


def read_visual_geometry(
    robot: UrdfRobot, built: Robot, max_triangles: int = MAX_TRIANGLES
) -> VisualGeometry | None:
    """Read the visual geometry about the body frame of the built robot.

    Args:
        robot: The section and its URDF.
        built: The robot built from it.
        max_triangles: Largest number of triangles of one shape.

    Returns:
        The geometry; None if the URDF has none.

    Raises:
        VisualGeometryError: A mesh does not exist or cannot be read. No plan depends on it.
    """
    chain = built.mechanism
    if not isinstance(chain, SerialChain):
        raise TypeError("a robot from a URDF is a serial chain")
    urdf_model = build_urdf_model(robot)
    try:
        text = write_visual_urdf(robot)
    except (UrdfFault, UrdfFaults) as fault:
        raise VisualGeometryError(str(fault)) from fault
    key = _VisualPiecesKey(
        text,
        tuple(sorted(robot.spec.locked_positions.items())),
        tuple(joint.name for leg in robot.joints.values() for joint in leg),
        (robot.base, robot.spec.forward, robot.spec.up),
        max_triangles,
        _list_mesh_stamps(text),
    )
    pieces = _CACHE.get(key)
    if pieces is None:
        pieces = _read_pieces(urdf_model, text, max_triangles)
        _CACHE[key] = pieces
        if len(_CACHE) > _CACHE_SIZE:
            _CACHE.popitem(last=False)
    if not pieces:
        return None
    # The chain is about the centre of mass, Pinocchio's joints about the base
    name = robot.limb_names[0]
    centre = urdf_model.read_leg(name).joints[-1] - chain.joint_zero[0, -1]
    vertices, faces, limbs, joints, count = [], [], [], [], 0
    for piece in pieces:
        vertices.append(piece.points - centre)
        faces.append(count + piece.triangles)
        limb, joint = _find_limb_joint(chain, piece.joint)
        limbs.append(np.full(len(piece.points), limb))
        joints.append(np.full(len(piece.points), joint))
        count += len(piece.points)
    return VisualGeometry(*(np.concatenate(arrays) for arrays in (vertices, faces, limbs, joints)))


class _VisualPiece(NamedTuple):
    """One shape, simplified, at zero angles."""

    points: Array  # (P, 3) base frame turned to x right, y forward, z up [m]
    triangles: IntArray  # (F, 3) indices of points
    joint: str  # of a leg, that carries it; "" for the body


class _VisualPiecesKey(NamedTuple):
    """All that the pieces of a robot depend on."""

    text: str  # of the visual URDF
    locked: tuple[tuple[str, float], ...]  # positions of locked joints
    joints: tuple[str, ...]  # of legs
    base: tuple[str, str, str]  # link, forward and up axis
    max_triangles: int
    stamps: tuple[tuple[str, int], ...]  # mesh files and the times at which they were changed


_CACHE_SIZE = 4  # robots whose simplified shapes are remembered
_CACHE: OrderedDict[_VisualPiecesKey, list[_VisualPiece]] = OrderedDict()


def _list_mesh_stamps(text: str) -> tuple[tuple[str, int], ...]:
    """Return the mesh files of a visual URDF with the times of their last changes [ns]."""
    return tuple(
        (name, Path(name).stat().st_mtime_ns if Path(name).is_file() else 0)
        for name in _list_mesh_files(text)
    )


@lru_cache(maxsize=_CACHE_SIZE)
def _list_mesh_files(text: str) -> tuple[str, ...]:
    """Return the mesh files of a visual URDF."""
    elements = parse_xml(text).walk()
    return tuple(sorted({mesh.attributes["filename"] for mesh in elements if mesh.tag == "mesh"}))


def _read_pieces(urdf_model: UrdfModel, text: str, max_triangles: int) -> list[_VisualPiece]:
    """Return the simplified shapes of a visual URDF; raises VisualGeometryError for bad meshes."""
    pin, model = urdf_model.library, urdf_model.model
    try:
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)
    except (RuntimeError, ValueError) as error:
        raise VisualGeometryError(str(error).strip().splitlines()[-1]) from error
    data = model.createData()
    pin.forwardKinematics(model, data, urdf_model.build_configuration({}))
    leg_joints = {joint.name for leg in urdf_model.robot.joints.values() for joint in leg}
    pieces = []
    for item in geometry.geometryObjects:
        points, triangles = simplify_mesh(*_triangulate(item.geometry), max_triangles)
        if not len(triangles):
            continue
        placement = data.oMi[item.parentJoint] * item.placement
        placed = urdf_model.to_base_axes(points @ placement.rotation.T + placement.translation)
        joint = find_carrying_joint(model, item.parentJoint, leg_joints)
        pieces.append(_VisualPiece(placed, triangles, joint))
    return pieces


def simplify_mesh(
    vertices: Array, faces: IntArray, max_triangles: int = MAX_TRIANGLES
) -> tuple[Array, IntArray]:
    """Return about `max_triangles` triangles (F, 3) of vertices (V, 3), by quadric errors.

    Meshes with fewer triangles are returned unchanged.

    Raises:
        VisualGeometryError: The library for it is not installed.
    """
    if len(faces) <= max_triangles:
        return vertices, faces
    try:
        mesh = trimesh.Trimesh(vertices, faces).simplify_quadric_decimation(
            face_count=max_triangles
        )
    except ImportError as error:
        raise VisualGeometryError(
            "large meshes are drawn with fewer triangles by fast-simplification: "
            "pip install 'climbplan[urdf]'"
        ) from error
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)


def index_submeshes(faces: IntArray, vertex_count: int) -> IntArray:
    """Return the triangles (F, 3) of a mesh file with the vertices of their own submesh.

    Coal appends the vertices of all submeshes (one a material) of a node, but counts those of each
    submesh from zero. A submesh begins with the triangle (0, 1, 2). Triangles are returned
    unchanged where the submeshes between such triangles do not have all vertices together.
    """
    starts = np.flatnonzero((faces == np.arange(3)).all(axis=1))
    if len(starts) < 2 or starts[0] != 0:
        return faces
    submeshes = np.split(faces, starts[1:])
    counts = [int(submesh.max()) + 1 for submesh in submeshes]
    if sum(counts) != vertex_count:
        return faces
    offsets = np.cumsum([0, *counts[:-1]])
    return np.concatenate(
        [submesh + offset for submesh, offset in zip(submeshes, offsets, strict=True)]
    )


def _find_limb_joint(chain: SerialChain, joint: str) -> tuple[int, int]:
    """Return limb and joint of a chain's joint by name, the first limb's where several share it."""
    for limb, names in enumerate(chain.names):
        if joint and joint in names:
            return limb, names.index(joint)
    return BODY, 0


def _triangulate(geometry: Any) -> tuple[Array, IntArray]:
    """Return vertices and triangles of one piece of geometry in its own frame."""
    kind = type(geometry).__name__
    if kind == "Sphere":
        mesh = trimesh.creation.icosphere(2, float(geometry.radius))
    elif kind == "Capsule":
        mesh = trimesh.creation.capsule(
            2 * float(geometry.halfLength), float(geometry.radius), count=(12, 12)
        )
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
    elif kind == "Cylinder":
        length = 2 * float(geometry.halfLength)
        mesh = trimesh.creation.cylinder(float(geometry.radius), length, 24)
    elif kind == "Box":
        mesh = trimesh.creation.box(2 * np.array(geometry.halfSide, float))
    else:
        vertices = np.array(geometry.vertices(), float).reshape(-1, 3)
        rows = [geometry.tri_indices(k) for k in range(geometry.num_tris)]
        faces = np.array([[t[0], t[1], t[2]] for t in rows], np.int64).reshape(-1, 3)
        return vertices, index_submeshes(faces, len(vertices))
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)
