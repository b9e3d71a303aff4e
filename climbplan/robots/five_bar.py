"""Legs of a vertical yaw joint and a planar five-bar linkage, in closed form.

In the leg's vertical plane, x outward from the yaw axis and z up, two cranks turn about axes F and
A on the body. Crank F carries the last link at its end, the elbow E; crank A holds that link by a
coupler at its point C:

    E = F + f (sin F', -cos F'),  C = E + R(t) c,  |C - A - a (sin A', -cos A')| = coupler

with crank angles F', A' from straight down towards outward, tilt t of the last link likewise, and
c = (along, across) in the link's frame. Joints are those of the motors: yaw, crank F, crank A.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.mechanism import BOUND_SLACK, InverseKinematics, Miss
from climbplan.robots.rotations import frame_in_plane

JOINTS = ("yaw", "crank F", "crank A")
_STEP = 1e-6  # [rad] of the Hessian's difference quotients


@dataclass(frozen=True)
class Linkage:
    """Lengths of the linkage, the same in every leg [m]."""

    offset: float  # of both cranks' axes outward from the yaw axis
    axis_f: float  # height of crank F's axis above the shoulder
    axis_a: float  # height of crank A's axis above the shoulder
    crank_f: float
    crank_a: float
    coupler: float
    link: float  # from the elbow to the toe
    held_along: float  # where the coupler holds the last link: along it from the elbow
    held_across: float  # and beside it, towards where the link turns at growing tilt


@dataclass(frozen=True)
class LegPlane:
    """A posture of N legs in their planes, x outward and z up; rates by (crank F, crank A)."""

    elbow: Array  # (..., N, 2) [m]
    tilt: Array  # (..., N) of the last link from straight down towards outward [rad]
    tilt_rates: Array  # (..., N, 2)


@dataclass(frozen=True)
class FiveBar:
    """N legs; J = 3, P = 4: shoulder, crank F's axis, elbow, toe."""

    shoulder_body: Array  # (N, 3) [m]
    mount_yaw: Array  # (N,) direction of the leg's plane at zero yaw [rad]
    linkage: Linkage

    @property
    def joint_names(self) -> tuple[tuple[str, ...], ...]:
        """Yaw, crank F and crank A of every leg."""
        return (JOINTS,) * len(self.mount_yaw)

    def only(self, limbs: slice) -> Self:
        """Return the mechanism of some legs."""
        return type(self)(self.shoulder_body[limbs], self.mount_yaw[limbs], self.linkage)

    def plane(self, angles: Array) -> LegPlane:
        """Return elbow and tilt for angles (..., N, 3) [rad]; NaN where the linkage is open."""
        bar = self.linkage
        f, a = angles[..., 1], angles[..., 2]
        elbow = np.array([bar.offset, bar.axis_f]) + bar.crank_f * _down(f)
        end = np.array([bar.offset, bar.axis_a]) + bar.crank_a * _down(a)
        to_crank_a = end - elbow
        distance = np.hypot(to_crank_a[..., 0], to_crank_a[..., 1])
        radius = np.hypot(bar.held_along, bar.held_across)
        with np.errstate(invalid="ignore"):
            opening = np.arccos(
                (radius**2 + distance**2 - bar.coupler**2) / (2 * radius * distance)
            )
        # From the direction of crank A to the coupler's joint on the link, then to the link itself
        direction = np.arctan2(to_crank_a[..., 1], to_crank_a[..., 0]) + opening
        tilt = direction - np.arctan2(bar.held_across, bar.held_along) + np.pi / 2
        tilt = tilt - 2 * np.pi * np.round(tilt / (2 * np.pi))
        # Rates by differentiating |C - end|^2 = coupler^2
        spoke = radius * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        rod = elbow + spoke - end
        by_tilt = _dot(rod, _rotate_quarter(spoke))
        by_f = _dot(rod, bar.crank_f * _rotate_quarter(_down(f)))
        by_a = -_dot(rod, bar.crank_a * _rotate_quarter(_down(a)))
        rates = -np.stack([by_f, by_a], axis=-1) / by_tilt[..., None]
        return LegPlane(elbow, tilt, rates)

    def joint_points(self, angles: Array) -> Array:
        """Return shoulder, crank F's axis, elbow and toe (..., N, 4, 3), body frame [m]."""
        plane = self.plane(angles)
        toe = plane.elbow + self.linkage.link * _down(plane.tilt)
        zero = np.zeros_like(toe)
        hip = zero + np.array([self.linkage.offset, self.linkage.axis_f])
        flat = np.stack([zero, hip, plane.elbow, toe], axis=-2)
        out = self._out(angles)
        points = flat[..., :1] * out[..., None, :]
        points[..., 2] += flat[..., 1]
        return self.shoulder_body[:, None, :] + points

    def jacobian(self, angles: Array) -> Array:
        """Return d(toe)/d(angles) (..., N, 3, 3) [m/rad]."""
        plane = self.plane(angles)
        out = self._out(angles)
        reach = plane.elbow[..., :1] + self.linkage.link * np.sin(plane.tilt)[..., None]
        sideways = np.stack([-out[..., 1], out[..., 0], np.zeros_like(out[..., 0])], axis=-1)
        by_tilt = self.linkage.link * _rotate_quarter(_down(plane.tilt))
        by_f = self.linkage.crank_f * _rotate_quarter(_down(angles[..., 1]))
        columns = [reach * sideways]
        for number, by_crank in enumerate((by_f, np.zeros_like(by_f))):
            flat = by_crank + plane.tilt_rates[..., number, None] * by_tilt
            column = flat[..., :1] * out
            column[..., 2] += flat[..., 1]
            columns.append(column)
        return np.stack(columns, axis=-1)

    def turning(self, angles: Array) -> Array:
        """Return the angular velocity of the last link by joint speed, (..., N, 3, 3)."""
        rates = self.plane(angles).tilt_rates
        out = self._out(angles)
        hinge = np.stack([out[..., 1], -out[..., 0], np.zeros_like(out[..., 0])], axis=-1)
        up = np.zeros_like(out) + np.array([0.0, 0.0, 1.0])
        return np.stack([up, rates[..., :1] * hinge, rates[..., 1:] * hinge], axis=-1)

    def last_link(self, angles: Array) -> Array:
        """Return rows x along the last link, y across it in the leg's plane, z the hinge."""
        return frame_in_plane(self._out(angles), self.plane(angles).tilt)

    def hessian(self, angles: Array) -> Array:
        """Return second derivatives of the toe (..., N, 3, 3, 3), by central differences."""
        columns = []
        for joint in range(3):
            step = np.zeros(3)
            step[joint] = _STEP
            ahead, behind = self.jacobian(angles + step), self.jacobian(angles - step)
            columns.append((ahead - behind) / (2 * _STEP))
        return np.stack(columns, axis=-1)

    def inverse(self, toes: Array, lower: Array, upper: Array) -> InverseKinematics:
        """Return joint angles for toes (..., N, 3); two branches: elbow up, elbow down."""
        bar = self.linkage
        offset = toes - self.shoulder_body
        yaw = np.arctan2(offset[..., 1], offset[..., 0]) - self.mount_yaw
        x = np.hypot(offset[..., 0], offset[..., 1]) - bar.offset
        z = offset[..., 2] - bar.axis_f
        span = np.hypot(x, z)
        gap = np.maximum(span - bar.crank_f - bar.link, np.abs(bar.crank_f - bar.link) - span)
        inner = (span**2 + bar.crank_f**2 - bar.link**2) / (2 * np.maximum(span, 1e-12))
        opening = np.arccos(np.clip(inner / bar.crank_f, -1.0, 1.0))
        branches, reached = [], []
        for side in (1.0, -1.0):
            f = np.arctan2(z, x) + side * opening + np.pi / 2
            a = self._crank_a(f, np.stack([x, z], axis=-1) - bar.crank_f * _down(f))
            branches.append(np.stack([yaw, f, np.where(np.isfinite(a), a, 0.0)], axis=-1))
            reached.append((gap <= BOUND_SLACK) & np.isfinite(a))
        stacked, reach = np.stack(branches, axis=-3), np.stack(reached, axis=-2)
        middle = (lower + upper) / 2
        wrapped = stacked - 2 * np.pi * np.round((stacked - middle) / (2 * np.pi))
        inside = (wrapped >= lower - BOUND_SLACK) & (wrapped <= upper + BOUND_SLACK)
        missing = np.broadcast_to(np.maximum(gap, 0.0)[..., None, :], reach.shape)
        return InverseKinematics(wrapped, reach, reach & inside.all(axis=-1), missing)

    def explain_miss(
        self, solution: InverseKinematics, toes: Array, limb: int, lower: Array, upper: Array
    ) -> Miss:
        """Explain why limb `limb` of a solution for toes (N, 3) is not valid."""
        gap = float(solution.missing[0, limb])
        if gap > BOUND_SLACK:
            return Miss("too far" if np.linalg.norm(toes[limb]) > 0.2 else "too near", gap)
        if not solution.reachable[:, limb].any():
            return Miss("its linkage does not close there", 0.0)
        angles = solution.angles[:, limb]
        excess = np.maximum(lower[limb] - angles, angles - upper[limb])
        excess = np.where(solution.reachable[:, limb, None], excess, np.inf)
        branch = int(np.argmin(excess.max(axis=-1)))
        joint = int(np.argmax(excess[branch]))
        return Miss(
            f"{JOINTS[joint]} {np.rad2deg(excess[branch, joint]):.1f} deg past its bound", 0
        )

    def _out(self, angles: Array) -> Array:
        """Return unit vectors (..., N, 3) outward in the legs' planes."""
        psi = self.mount_yaw + angles[..., 0]
        return np.stack([np.cos(psi), np.sin(psi), np.zeros_like(psi)], axis=-1)

    def _crank_a(self, f: Array, along: Array) -> Array:
        """Return the angle of crank A that closes the linkage.

        along: (..., 2) from elbow to toe [m].
        """
        bar = self.linkage
        x = along / np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-12)[..., None]
        elbow = np.array([0.0, bar.axis_f - bar.axis_a]) + bar.crank_f * _down(f)
        coupler_joint = elbow + bar.held_along * x + bar.held_across * _rotate_quarter(x)
        distance = np.hypot(coupler_joint[..., 0], coupler_joint[..., 1])
        with np.errstate(invalid="ignore"):
            inner = (bar.crank_a**2 + distance**2 - bar.coupler**2) / (2 * bar.crank_a * distance)
            return np.asarray(
                np.arctan2(coupler_joint[..., 0], -coupler_joint[..., 1]) - np.arccos(inner)
            )


def _down(angle: Array) -> Array:
    """Return unit vectors (..., 2) at angles from straight down towards outward."""
    return np.stack([np.sin(angle), -np.cos(angle)], axis=-1)


def _rotate_quarter(vector: Array) -> Array:
    """Return vectors (..., 2) rotated by a quarter turn, towards growing angles."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))
