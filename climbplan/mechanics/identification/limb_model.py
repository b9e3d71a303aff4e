"""Model of a limb's measured stiffness: springs at its joints, and a compliant structure.

K = (J c J^T + s 1)^-1 over the measured axes, eq. (4.7), with joint compliances c [rad/(N m)] and
an
isotropic compliance of the structure s [m/N]. A structure that deflects in the shape of a joint's
motion cannot be distinguished from that joint, unless the motors' gain is varied: joints then
soften as 1/gain, the structure does not.

Limbs of coxa, femur and tibia are measured in their own frame, x outward, y across, z up, and may
be measured in their plane alone. All others are measured in the frame of the body, x to the right,
y forward, z up, which stands still.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.mechanics.identification.measurements import AngleColumns
from climbplan.robots.kinematics import jacobian_body
from climbplan.robots.model import Robot


@dataclass(frozen=True)
class MeasuredLimb:
    """The geometry of the limb that was measured."""

    robot: Robot
    axes: tuple[int, ...]  # measured
    number: int = 0  # of the limb

    @property
    def angles(self) -> AngleColumns:
        """The angles that describe its posture."""
        return angle_columns(self.robot, self.number)

    @property
    def joints(self) -> tuple[int, ...]:
        """The angles that the measured axes feel: in the limb's plane all but the coxa."""
        planar = self.robot.mechanism is None and len(self.axes) == 2
        return tuple(range(int(planar), len(self.angles.names)))

    @property
    def felt(self) -> tuple[str, ...]:
        """Names of these joints."""
        return tuple(self.angles.names[j] for j in self.joints)

    @property
    def lengths(self) -> Array:
        """Lengths of coxa, femur, tibia, or distances between joints and toe, (j,) [m]."""
        return np.asarray(self.robot.link_lengths[self.number])

    def reaches(self, distance: float, radial: bool) -> bool:
        """Return whether a foot may be that far [m] from the femur joint.

        radial: in any direction, else level.
        """
        _, l2, l3 = self.lengths
        return bool(distance < l2 + l3 and not (radial and distance <= abs(l3 - l2)))

    def jacobians(self, angles: Array) -> Array:
        """Return toe motion along the measured axes by the joints felt, (T, a, j).

        angles: (T, J) [rad].
        """
        if self.robot.mechanism is not None:
            has = np.flatnonzero(self.robot.has_joint[self.number])
            complete = np.zeros((len(angles), 1, self.robot.joint_count))
            complete[:, 0, has] = angles
            jacobian = jacobian_body(self.robot.one_limb(self.number), complete)[:, 0]
            return np.asarray(jacobian[:, self.axes, :][:, :, has])
        count = len(angles)
        plane = angles if len(self.axes) == 3 else angles * [0.0, 1.0, 1.0]
        planar = replace(
            self.robot,
            mount_yaw=np.zeros(count),
            link_lengths=np.broadcast_to(self.lengths, (count, 3)),
        )
        return np.asarray(jacobian_body(planar, plane)[:, self.axes, :][:, :, self.joints])

    def angles_for_foot(self, x: Array, z: Array) -> Array:
        """Return joint angles (..., 3), knee up, for feet (x, z) from the femur joint.

        NaN out of reach. Knee down, the limb would have the mirrored stiffness and lie beyond usual
        joint bounds.
        """
        _, l2, l3 = self.lengths
        cosine = (x**2 + z**2 - l2**2 - l3**2) / (2 * l2 * l3)
        cosine = np.where(np.abs(cosine) <= 1, cosine, np.nan)
        beta = -np.arccos(cosine)  # from femur to tibia, positive upward
        femur = np.arctan2(z, x) - np.arctan2(l3 * np.sin(beta), l2 + l3 * np.cos(beta))
        tibia = np.broadcast_to(beta + np.pi / 2, femur.shape)
        return np.stack([np.zeros_like(femur), femur, tibia], axis=-1)


def angle_columns(robot: Robot, number: int) -> AngleColumns:
    """Return the angles of one of a robot's limbs; the coxa turns across the limb's plane."""
    joint_names = robot.limbs.joint_names[number]
    names = tuple(name for name in joint_names if name)
    slides = frozenset(
        n for n, is_slide in zip(joint_names, robot.slides[number], strict=True) if is_slide
    )
    return AngleColumns(names, names[0] if robot.mechanism is None else None, slides & {*names})


def limb_matrices(jacobian: Array, joint_compliance: Array, structure: Array | float) -> Array:
    """Return stiffness matrices K (..., a, a) [N/m].

    jacobian: (..., a, j); joint_compliance: (..., j) [rad/(N m)]; structure: (...) [m/N].
    """
    compliance = jacobian * joint_compliance[..., None, :] @ np.swapaxes(jacobian, -1, -2)
    size = jacobian.shape[-2]
    compliance = compliance + np.asarray(structure)[..., None, None] * np.eye(size)
    # A stretched limb is infinitely stiff along itself; this much give keeps the matrix finite.
    trace = np.trace(compliance, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(np.linalg.inv(compliance + 1e-9 * trace * np.eye(size)))
