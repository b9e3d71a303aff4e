"""What a limb's measured stiffness ought to be: springs at its joints, and a structure that gives.

K = (J c J^T + s 1)^-1 over the measured axes, eq. (4.7), with joint compliances c [rad/(N m)] and a
structure that gives s [m/N] alike in all directions. A structure that gives in the shape of a
joint's motion cannot be told from that joint, unless the motors' gain is varied: joints then
soften as 1/gain, structure does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.robots.kinematics import jacobian_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array


@dataclass(frozen=True)
class Limb:
    """The geometry of the limb that was measured."""

    robot: Robot  # whose first limb it is
    axes: tuple[int, ...]  # measured

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints that the measured axes feel: in the limb's plane the coxa is not among them."""
        return (0, 1, 2) if len(self.axes) == 3 else (1, 2)

    @property
    def lengths(self) -> Array:
        """(3,) coxa, femur, tibia [m]."""
        return np.asarray(self.robot.link_lengths[0])

    def jacobians(self, angles: Array) -> Array:
        """(T, a, j) toe motion along the measured axes by the joints felt, angles (T, 3) [rad]."""
        count = len(angles)
        plane = angles if len(self.axes) == 3 else angles * [0.0, 1.0, 1.0]
        posed = replace(
            self.robot,
            mount_yaw=np.zeros(count),
            link_lengths=np.broadcast_to(self.lengths, (count, 3)),
        )
        return np.asarray(jacobian_body(posed, plane)[:, self.axes, :][:, :, self.joints])

    def angles_for_foot(self, x: Array, z: Array) -> Array:
        """Joint angles (..., 3), knee up, for feet (x, z) from the femur joint; NaN out of reach.

        Knee down, the limb would have the mirrored stiffness and lie beyond usual joint bounds.
        """
        _, l2, l3 = self.lengths
        cosine = (x**2 + z**2 - l2**2 - l3**2) / (2 * l2 * l3)
        cosine = np.where(np.abs(cosine) <= 1, cosine, np.nan)
        beta = -np.arccos(cosine)  # from femur to tibia, positive upward
        femur = np.arctan2(z, x) - np.arctan2(l3 * np.sin(beta), l2 + l3 * np.cos(beta))
        tibia = np.broadcast_to(beta + np.pi / 2, femur.shape)
        return np.stack([np.zeros_like(femur), femur, tibia], axis=-1)


def limb_matrices(jacobian: Array, joint_compliance: Array, structure: Array | float) -> Array:
    """K (..., a, a) [N/m] for jacobian (..., a, j), compliances (..., j), structure (...) [m/N]."""
    soft = jacobian * joint_compliance[..., None, :] @ np.swapaxes(jacobian, -1, -2)
    size = jacobian.shape[-2]
    soft = soft + np.asarray(structure)[..., None, None] * np.eye(size)
    # A stretched limb is infinitely stiff along itself; this much give keeps the matrix finite.
    trace = np.trace(soft, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(np.linalg.inv(soft + 1e-9 * trace * np.eye(size)))
