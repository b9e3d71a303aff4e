"""Closed-form kinematics of limbs of coxa, femur and tibia.

With yaw psi = mount_yaw + theta_1 the toe of a limb lies at radius
L1 + L2 cos(theta_2) + L3 sin(theta_2 + theta_3) from the shoulder and at height
L2 sin(theta_2) - L3 cos(theta_2 + theta_3): at zero angles the femur points outward and the tibia
straight down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.mechanism import BOUND_SLACK, InverseKinematics, Miss
from climbplan.robots.rotations import frame_in_plane

JOINTS = ("coxa", "femur", "tibia")


@dataclass(frozen=True)
class CoxaFemurTibia:
    """N limbs with a vertical first joint and two parallel ones; J = 3, P = 4."""

    shoulder_body: Array  # (N, 3) first joint [m]
    mount_yaw: Array  # (N,) direction of the coxa at zero angle [rad]
    link_lengths: Array  # (N, 3) coxa, femur, tibia [m]

    @property
    def joint_names(self) -> tuple[tuple[str, ...], ...]:
        """Coxa, femur and tibia of every limb."""
        return (JOINTS,) * len(self.mount_yaw)

    def only(self, limbs: slice) -> Self:
        """Return the mechanism of some limbs."""
        return type(self)(
            self.shoulder_body[limbs], self.mount_yaw[limbs], self.link_lengths[limbs]
        )

    def joint_points(self, angles: Array) -> Array:
        """Return shoulder, femur joint, knee and toe of every limb.

        angles: (..., N, 3) [rad]. Returns (..., N, 4, 3) in the body frame [m].
        """
        l1, l2, l3 = self.link_lengths.T
        psi = self.mount_yaw + angles[..., 0]
        tilt = angles[..., 1] + angles[..., 2]
        radius = np.stack([np.zeros_like(psi), np.broadcast_to(l1, psi.shape)], axis=-1)
        knee_r = l1 + l2 * np.cos(angles[..., 1])
        toe_r = knee_r + l3 * np.sin(tilt)
        knee_z = l2 * np.sin(angles[..., 1])
        toe_z = knee_z - l3 * np.cos(tilt)
        radius = np.concatenate(
            [radius, knee_r[..., None], toe_r[..., None]], axis=-1
        )  # (..., N, 4)
        height = np.stack([np.zeros_like(psi), np.zeros_like(psi), knee_z, toe_z], axis=-1)
        offset = np.stack(
            [radius * np.cos(psi)[..., None], radius * np.sin(psi)[..., None], height], axis=-1
        )
        return self.shoulder_body[:, None, :] + offset

    def jacobian(self, angles: Array) -> Array:
        """Return d(toe_body)/d(angles) of every limb, (..., N, 3, 3), body frame [m/rad]."""
        l1, l2, l3 = self.link_lengths.T
        psi = self.mount_yaw + angles[..., 0]
        tilt = angles[..., 1] + angles[..., 2]
        cos_psi, sin_psi = np.cos(psi), np.sin(psi)
        toe_r = l1 + l2 * np.cos(angles[..., 1]) + l3 * np.sin(tilt)
        tibia_dr, tibia_dz = l3 * np.cos(tilt), l3 * np.sin(tilt)
        femur_dr = tibia_dr - l2 * np.sin(angles[..., 1])
        femur_dz = tibia_dz + l2 * np.cos(angles[..., 1])
        columns = [
            np.stack([-toe_r * sin_psi, toe_r * cos_psi, np.zeros_like(psi)], axis=-1),
            np.stack([femur_dr * cos_psi, femur_dr * sin_psi, femur_dz], axis=-1),
            np.stack([tibia_dr * cos_psi, tibia_dr * sin_psi, tibia_dz], axis=-1),
        ]
        return np.stack(columns, axis=-1)

    def turning(self, angles: Array) -> Array:
        """Return the angular velocity of the tibia by joint speed (..., N, 3, 3): joint axes."""
        psi = self.mount_yaw + angles[..., 0]
        zero = np.zeros_like(psi)
        up = np.stack([zero, zero, zero + 1.0], axis=-1)
        hinge = np.stack([np.sin(psi), -np.cos(psi), zero], axis=-1)
        return np.stack([up, hinge, hinge], axis=-1)

    def last_link(self, angles: Array) -> Array:
        """Return rows (..., N, 3, 3): x along the tibia, y across it in the plane, z hinge."""
        psi = self.mount_yaw + angles[..., 0]
        outward = np.stack([np.cos(psi), np.sin(psi), np.zeros_like(psi)], axis=-1)
        return frame_in_plane(outward, angles[..., 1] + angles[..., 2])

    def hessian(self, angles: Array) -> Array:
        """Return second derivatives of toe_body by the angles, (..., N, 3, 3, 3) [m/rad^2].

        The first of the last three axes is the toe's, body frame.
        """
        l1, l2, l3 = self.link_lengths.T
        psi = self.mount_yaw + angles[..., 0]
        tilt = angles[..., 1] + angles[..., 2]
        tibia_r, tibia_z = l3 * np.sin(tilt), -l3 * np.cos(tilt)
        femur_r, femur_z = l2 * np.cos(angles[..., 1]), l2 * np.sin(angles[..., 1])
        zero = np.zeros_like(psi)
        outward = np.stack([np.cos(psi), np.sin(psi), zero], axis=-1)
        lateral = np.stack([-np.sin(psi), np.cos(psi), zero], axis=-1)
        up = np.array([0.0, 0.0, 1.0])
        folded = (
            -tibia_r[..., None] * outward - tibia_z[..., None] * up
        )  # towards the joint that turns
        out = np.empty((*psi.shape, 3, 3, 3))
        out[..., 0, 0] = -(l1 + femur_r + tibia_r)[..., None] * outward
        out[..., 0, 1] = out[..., 1, 0] = -(tibia_z + femur_z)[..., None] * lateral
        out[..., 0, 2] = out[..., 2, 0] = -tibia_z[..., None] * lateral
        out[..., 1, 1] = folded - femur_r[..., None] * outward - femur_z[..., None] * up
        out[..., 1, 2] = out[..., 2, 1] = out[..., 2, 2] = folded
        return out

    def inverse(self, toes: Array, lower: Array, upper: Array) -> InverseKinematics:
        """Return joint angles that put the toes at toes (..., N, 3), body frame [m]."""
        l1, l2, l3 = self.link_lengths.T
        offset = toes - self.shoulder_body
        direction = np.arctan2(offset[..., 1], offset[..., 0])
        distance = np.hypot(offset[..., 0], offset[..., 1])
        angles, reachable, missing = [], [], []
        for turn, sign in ((0.0, 1.0), (np.pi, -1.0)):
            u = sign * distance - l1
            z = offset[..., 2]
            span = np.hypot(u, z)
            cos_beta = (span**2 - l2**2 - l3**2) / (2 * l2 * l3)
            gap = np.maximum(span - (l2 + l3), np.abs(l2 - l3) - span)
            # beta: angle from femur to tibia; rounding at full stretch is not out of reach
            beta = np.arccos(np.clip(cos_beta, -1.0, 1.0))
            for bend in (-beta, beta):
                femur = np.arctan2(z, u) - np.arctan2(l3 * np.sin(bend), l2 + l3 * np.cos(bend))
                coxa = direction + turn - self.mount_yaw
                angles.append(np.stack([coxa, femur, bend + np.pi / 2], axis=-1))
                reachable.append(gap <= 1e-9)
                missing.append(np.maximum(gap, 0.0))
        stacked = np.stack(angles, axis=-3)  # (..., 4, N, 3)
        middle = (lower + upper) / 2
        wrapped = stacked - 2 * np.pi * np.round((stacked - middle) / (2 * np.pi))
        inside = (wrapped >= lower - BOUND_SLACK) & (wrapped <= upper + BOUND_SLACK)
        reach = np.stack(reachable, axis=-2)
        return InverseKinematics(
            angles=wrapped,
            reachable=reach,
            within_bounds=reach & inside.all(axis=-1),
            missing=np.stack(missing, axis=-2),
        )

    def explain_miss(
        self, solution: InverseKinematics, toes: Array, limb: int, lower: Array, upper: Array
    ) -> Miss:
        """Explain why limb `limb` of a solution for toes (N, 3) is not valid.

        Only the branches that face the toe count: nobody means to turn the coxa away.
        """
        if not solution.reachable[:2, limb].any():
            gap = float(solution.missing[:2, limb].min())
            offset = toes[limb] - self.shoulder_body[limb]
            u = np.hypot(offset[0], offset[1]) - self.link_lengths[limb, 0]
            is_far = np.hypot(u, offset[2]) > self.link_lengths[limb, 1:].sum()
            return Miss("too far" if is_far else "too near", gap)
        excess = np.maximum(
            lower[limb] - solution.angles[:2, limb], solution.angles[:2, limb] - upper[limb]
        )
        branch = int(np.argmin(excess.max(axis=-1)))
        joint = int(np.argmax(excess[branch]))
        excess_angle = float(excess[branch, joint])
        reason = f"{JOINTS[joint]} {np.rad2deg(excess_angle):.1f} deg past its bound"
        return Miss(reason, 0.0, joint, excess_angle)
