"""How a robot looks, from the visual geometry of its URDF, with large meshes made coarser."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from climbplan.arrays import Array, IntArray
from climbplan.robots.looks import BODY, Looks
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.normal_document import visual_document
from climbplan.robots.urdf.pinocchio_model import urdf_model
from climbplan.robots.urdf.shapes import carrier
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults

MOST_TRIANGLES = 5000  # of one shape of a link


class NoLooks(Exception):
    """Visual geometry that is missing or cannot be read; says in words which."""


def looks_of(robot: UrdfRobot, built: Robot, most: int = MOST_TRIANGLES) -> Looks | None:
    """The visual geometry about the body frame of the built robot; None where the URDF has none.

    most: triangles of one shape. Raises NoLooks for a mesh that is not there or that cannot be
    read: nothing that is planned rests on it.
    """
    chain = built.mechanism
    if not isinstance(chain, SerialChain):
        raise TypeError("a robot from a URDF is a serial chain")
    found = urdf_model(robot)
    pin, model = found.library, found.model
    try:
        text = visual_document(robot)
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)
    except (UrdfFault, UrdfFaults) as fault:
        raise NoLooks(str(fault)) from fault
    except (RuntimeError, ValueError) as error:
        raise NoLooks(str(error).strip().splitlines()[-1]) from error
    data = model.createData()
    pin.forwardKinematics(model, data, found.angles({}))
    moved = {joint.name for leg in robot.joints.values() for joint in leg}
    # The chain is about the centre of mass, Pinocchio's joints about the base
    name = robot.limb_names[0]
    centre = found.leg(name).joints[-1] - chain.joint_zero[0, -1]
    vertices, faces, limbs, joints, count = [], [], [], [], 0
    for item in geometry.geometryObjects:
        points, own = coarser(*_triangles(item.geometry), most)
        if not len(own):
            continue
        at = data.oMi[item.parentJoint] * item.placement
        vertices.append(found.placed(points @ at.rotation.T + at.translation) - centre)
        faces.append(count + own)
        limb, joint = _place(chain, carrier(model, item.parentJoint, moved))
        limbs.append(np.full(len(points), limb))
        joints.append(np.full(len(points), joint))
        count += len(points)
    if not vertices:
        return None
    return Looks(*(np.concatenate(part) for part in (vertices, faces, limbs, joints)))


def coarser(vertices: Array, faces: IntArray, most: int = MOST_TRIANGLES) -> tuple[Array, IntArray]:
    """Some `most` triangles (F, 3) of vertices (V, 3), by quadric errors; few stay as they are.

    Raises NoLooks without the library that does it.
    """
    if len(faces) <= most:
        return vertices, faces
    try:
        mesh = trimesh.Trimesh(vertices, faces).simplify_quadric_decimation(face_count=most)
    except ImportError as error:
        raise NoLooks(
            "large meshes are drawn with fewer triangles by fast-simplification: "
            "pip install 'climbplan[urdf]'"
        ) from error
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)


def _place(chain: SerialChain, joint: str) -> tuple[int, int]:
    """Limb and joint of a chain's joint by name, the first limb's where several share it."""
    for limb, names in enumerate(chain.names):
        if joint and joint in names:
            return limb, names.index(joint)
    return BODY, 0


def _triangles(geometry: Any) -> tuple[Array, IntArray]:
    """One piece of geometry in its own frame."""
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
        return vertices, np.array([[t[0], t[1], t[2]] for t in rows], np.int64).reshape(-1, 3)
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)
