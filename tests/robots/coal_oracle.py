"""A robot's own collision geometry, from its URDF, by Pinocchio and coal alone.

Nothing of our capsules, kinematics or distances is used: the base is placed by where the joints of
the legs are at zero angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from climbplan.arrays import Array
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain


@dataclass
class UrdfGeometry:
    """Collision geometry of a URDF whose legs are those of a robot."""

    robot: Robot
    model: pin.Model
    geometry: pin.GeometryModel
    base: pin.SE3  # of the URDF's root in the robot's body frame

    @classmethod
    def of(cls, robot: Robot, urdf: Path) -> UrdfGeometry:
        """Read a URDF; meshes are replaced by their convex hulls, which hold them."""
        model = pin.buildModelFromUrdf(str(urdf))
        folders = [str(folder) for folder in [urdf.parent, *urdf.parents]]
        geometry = pin.buildGeomFromUrdf(
            model, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders
        )
        for part in geometry.geometryObjects:
            if isinstance(part.geometry, coal.BVHModelBase):
                part.geometry.buildConvexHull(True, "Qt")
                part.geometry = part.geometry.convex
        chain = robot.mechanism
        assert isinstance(chain, SerialChain)
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        pairs = [
            (data.oMi[model.getJointId(name)].translation, chain.joint_zero[limb, j])
            for limb, names in enumerate(chain.joint_names)
            for j, name in enumerate(names)
            if name
        ]
        root, body = (np.array(points) for points in zip(*pairs, strict=True))
        u, _, vt = np.linalg.svd((body - body.mean(0)).T @ (root - root.mean(0)))
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        base = pin.SE3(turn, body.mean(0) - turn @ root.mean(0))
        assert np.abs(root @ turn.T + base.translation - body).max() < 1e-6
        return cls(robot, model, geometry, base)

    def parts(self, angles: Array) -> list[tuple[str, int, coal.CollisionGeometry, pin.SE3]]:
        """Name, limb (-1 for none), shape and place in the body frame, at angles (N, J)."""
        chain = self.robot.mechanism
        assert isinstance(chain, SerialChain)
        q, limb_of = pin.neutral(self.model), np.full(self.model.njoints, -1)
        for limb, names in enumerate(chain.joint_names):
            for j, name in enumerate(names):
                if name:
                    joint = self.model.getJointId(name)
                    q[self.model.joints[joint].idx_q] = angles[limb, j]
                    limb_of[joint] = limb
        data = self.model.createData()
        placed = pin.GeometryData(self.geometry)
        pin.updateGeometryPlacements(self.model, data, self.geometry, placed, q)
        return [
            (part.name, int(limb_of[part.parentJoint]), part.geometry, self.base * place)
            for part, place in zip(self.geometry.geometryObjects, placed.oMg, strict=True)
        ]

    def heights(self, angles: Array, normal: Array) -> Array:
        """(N,) least of normal . x over the geometry of each limb, in the body frame [m]."""
        far = 10.0  # [m] of a half-space behind everything
        space = coal.Halfspace(np.asarray(normal, float), -far)
        least = np.full(self.robot.limb_count, np.inf)
        for _, limb, shape, place in self.parts(angles):
            if limb >= 0:
                at = coal.Transform3s(place.rotation, place.translation)
                away = _distance(shape, at, space, coal.Transform3s())
                least[limb] = min(least[limb], away - far)
        return least

    def depths(self, body: pin.SE3, angles: Array, corners: Array) -> list[tuple[float, str, int]]:
        """How deep [m] parts are in the hull of corners (V, 3), with their names and limbs."""
        cloud = coal.StdVec_Vec3s()
        for corner in corners:
            cloud.append(np.asarray(corner, float))
        points = coal.BVHModelOBBRSS()
        points.beginModel(0, len(corners))
        points.addVertices(np.asarray(corners, float))
        points.endModel()
        points.buildConvexHull(True, "Qt")
        found = []
        for name, limb, shape, place in self.parts(angles):
            where = body * place
            at = coal.Transform3s(where.rotation, where.translation)
            away = _distance(shape, at, points.convex, coal.Transform3s())
            found.append((-away, name, limb))
        return found


def _distance(one: object, at: object, other: object, there: object) -> float:
    """Signed distance [m], negative where two shapes overlap."""
    result = coal.DistanceResult()
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    coal.distance(one, at, other, there, request, result)
    return float(result.min_distance)
