"""Attitude boxes: ranges of angles and angular velocities about known motions, at each knot.

The relaxation keeps roll, pitch, yaw and the angular velocity within an attitude box, as the
published formulation keeps them within the ranges of Table 8.4. Within the box each entry of
rotation, rates and inertia is its value at the middle, or its linearisation, up to a remainder.
That is bounded by its largest value on a grid, and by the error of multilinear interpolation of a
function with such second derivatives.

Published methods, and table numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.walking.check.reference_dynamics import integrate_knot
from climbplan.walking.task.task import ANGLES, SPIN, RigidBody, WalkTask

_GRID = 21  # points of an angle
_ROUNDING = 1e-12
_MIN_OMEGA_MARGIN = 1e-7  # [rad/s] that ranges of angular velocities are widened by, for rounding
_NEAR_ANGLE = 0.5  # [rad] a reference that is so near is in the box
_NEAR_OMEGA = _NEAR_ANGLE * 10  # [rad/s] so is an angular velocity of zero


@dataclass(frozen=True)
class AttitudeBox:
    """Middles and half widths at knots 0 to N."""

    angles: Array  # (N + 1, 3) [rad]
    angles_half: Array
    omega: Array  # (N + 1, 3) [rad/s]
    omega_half: Array
    heading: Array  # (N + 1,) [rad] yaw of the axes of arms and forces

    def contains(self, state: Array) -> bool:
        """Return whether a motion (N + 1, 12) is in the box."""
        angles, omega = self.compute_violation(state)
        return bool(angles.max() <= 1e-9 and omega.max() <= 1e-9)

    def compute_violation(self, state: Array) -> tuple[Array, Array]:
        """Return how far a motion leaves the box; the last angular velocity rotates nothing.

        Args:
            state: The motion (N + 1, 12).

        Returns:
            Violations of angles (3,) [rad] and of angular velocities (3,) [rad/s]; 0 or less if the
            motion is in the box.
        """
        angles = np.abs(state[:, ANGLES] - self.angles) - self.angles_half
        omega = np.abs(state[:-1, SPIN] - self.omega[:-1]) - self.omega_half[:-1]
        return angles.max(axis=0), omega.max(axis=0)


def build_attitude_box(task: WalkTask, state: Array, angles: Array, omega: Array) -> AttitudeBox:
    """Build the attitude box about motions, and about references near them.

    The box of several motions is the hull of their boxes at each knot. At the first two knots of
    forward Euler the start alone decides, so that the box has no width there.

    Args:
        task: The task.
        state: Motions (..., N + 1, 12).
        angles: Half width about each motion (3,) [rad].
        omega: Half width of angular velocities about each motion (3,) [rad/s].

    Returns:
        The box, with the heading of its middle.
    """
    state = state.reshape(-1, *state.shape[-2:])
    reference = np.vstack([task.start.state[ANGLES], task.reference.euler])
    euler = state[..., ANGLES]
    tracked = np.where(np.abs(reference - euler) < _NEAR_ANGLE, reference, euler)
    low = np.minimum(euler, tracked).min(axis=0) - angles
    high = np.maximum(euler, tracked).max(axis=0) + angles
    spin = state[..., SPIN]
    is_slow = np.abs(spin) < _NEAR_OMEGA
    omega_low = np.where(is_slow, np.minimum(spin, 0.0), spin).min(axis=0) - omega
    omega_high = np.where(is_slow, np.maximum(spin, 0.0), spin).max(axis=0) + omega
    none = np.zeros((1, task.body.leg_count, 3))
    after = integrate_knot(task.body, "euler", task.dt, task.start.state[None], none, none)[0]
    low[0] = high[0] = task.start.state[ANGLES]
    low[1] = high[1] = after[ANGLES]
    omega_low[0] = omega_high[0] = task.start.state[SPIN]
    middle = 0.5 * (low + high)
    return AttitudeBox(
        angles=middle,
        angles_half=0.5 * (high - low),
        omega=0.5 * (omega_low + omega_high),
        omega_half=0.5 * (omega_high - omega_low),
        heading=middle[:, 2].copy(),
    )


@dataclass(frozen=True)
class RotationBounds:
    """Rotation and inertia at a knot at the middle of an attitude box, and their errors within it.

    R is the rotation from the body to the world frame, "middle" that at the middle of the box, and
    w the rotation vector from there about the body axes, linear in the angles.
    """

    R: Array  # (3, 3) middle
    R_error: Array  # (3, 3)
    inverse_inertia: Array  # (3, 3) middle, world frame
    inverse_inertia_error: Array  # (3, 3)
    inertia: Array  # (3, 3) middle, world frame
    inertia_error: Array  # (3, 3)
    inertia_remainder_low: Array  # (3, 3) inertia about the principal axes, less its linearisation
    inertia_remainder_high: Array
    rotation_remainder_low: Array  # (3, 3) rotation about the same axes, less its linearisation
    rotation_remainder_high: Array
    principal_axes: Array  # (3, 3) of the inertia, body frame, as columns
    principal_moments: Array  # (3,) of inertia
    principal_omega_low: Array  # (3,) angular velocity about the principal axes
    principal_omega_high: Array
    turn_jacobian: Array  # (3, 3) of w with respect to the angles
    max_turn: Array  # (3,) largest |w|
    omega_remainder_low: Array  # (3,) (R^T R_middle - 1 + [w]) R_middle^T omega
    omega_remainder_high: Array
    heading_axes: Array  # (3, 3) rotated by the heading, as columns
    arm_low: Array  # (L, 3) toe from the body, about the heading axes
    arm_high: Array
    world_arm_low: Array  # (L, 3) r, toe from the body in the world frame
    world_arm_high: Array
    middle_arm_low: Array  # (L, 3) R_middle^T r
    middle_arm_high: Array
    toe_remainder_low: Array  # (L, 3) (R^T R_middle - 1 + [w]) R_middle^T r
    toe_remainder_high: Array


_CACHE_SIZE = 256
_cache: dict[bytes, RotationBounds] = {}  # by the numbers of a knot: nodes differ at few knots


def bound_rotation(task: WalkTask, attitude_box: AttitudeBox, n: int) -> RotationBounds:
    """Return rotation, inertia and their errors at knot n of an attitude box."""
    body = task.body
    numbers = [
        body.inertia,
        body.toe_center,
        body.toe_half,
        *(row[n] for row in vars(attitude_box).values()),
    ]
    key = np.concatenate([np.ravel(number) for number in numbers]).tobytes()
    if key not in _cache:
        if len(_cache) >= _CACHE_SIZE:
            _cache.clear()
        _cache[key] = _compute_rotation_bounds(task, attitude_box, n)
    return _cache[key]


def _compute_rotation_bounds(task: WalkTask, attitude_box: AttitudeBox, n: int) -> RotationBounds:
    """Compute the bounds of a knot on a grid of its angles."""
    middle, half = attitude_box.angles[n], attitude_box.angles_half[n]
    grid = _build_grid(middle, half)
    rotations = rotation_world_body(grid)
    R = rotation_world_body(middle)
    # The error of interpolation in a cell is an eighth of side^2 times the second derivative, for
    # each angle. Entries of rotations are constant, or sinusoids of each angle, no larger than 1.
    grid_error = float(((2.0 * half / (_GRID - 1)) ** 2).sum()) / 8.0 + _ROUNDING
    jacobian = _linearise_rotation(R, middle)
    turn = skew((grid - middle) @ jacobian.T)
    second_order = np.swapaxes(rotations, -1, -2) @ R - np.eye(3) + turn
    omega, omega_half = attitude_box.omega[n], attitude_box.omega_half[n]
    max_omega = float(np.linalg.norm(np.abs(omega) + omega_half))
    omega_remainder = _bound_linear_images(
        second_order @ R.T, omega[None], omega_half, grid_error * max_omega
    )
    heading_axes = rotation_world_body(np.array([0.0, 0.0, attitude_box.heading[n]]))
    # Second derivatives of w times a rotation: twice the slope of the rotation, and w times its
    # curvature.
    remainder_error = (3.0 + float(np.linalg.norm(np.abs(jacobian) @ half))) * grid_error
    toes = _bound_toe_images(
        task.body,
        {
            "arm": (heading_axes.T @ rotations, grid_error),
            "world_arm": (rotations, grid_error),
            "middle_arm": (R.T @ rotations, grid_error),
            "toe_remainder": (second_order @ R.T @ rotations, remainder_error),
        },
    )
    inertia = _bound_inertia(task.body.inertia, R, rotations, grid_error)
    principal = _bound_principal_remainders(
        task.body.inertia, R, rotations, (grid - middle) @ jacobian.T, grid_error
    )
    axes, moments = principal.axes, principal.moments
    principal_omega = _bound_rotated_omega(rotations @ axes, grid_error, omega, omega_half)
    return RotationBounds(
        R=R,
        R_error=np.abs(rotations - R).max(axis=0) + grid_error,
        inverse_inertia=inertia[0],
        inverse_inertia_error=inertia[1],
        inertia=inertia[2],
        inertia_error=inertia[3] + 2.0 * float(np.ptp(moments)) * grid_error,
        inertia_remainder_low=principal.inertia_low,
        inertia_remainder_high=principal.inertia_high,
        rotation_remainder_low=principal.rotation_low,
        rotation_remainder_high=principal.rotation_high,
        principal_axes=axes,
        principal_moments=moments,
        principal_omega_low=principal_omega[0],
        principal_omega_high=principal_omega[1],
        turn_jacobian=jacobian,
        max_turn=np.abs(jacobian) @ half,
        omega_remainder_low=omega_remainder[0][0],
        omega_remainder_high=omega_remainder[1][0],
        heading_axes=heading_axes,
        **toes,
    )


class _PrincipalRemainders(NamedTuple):
    """Second-order remainders of rotation and inertia about the principal axes."""

    axes: Array  # (3, 3) principal axes, body frame, as columns
    moments: Array  # (3,) principal moments of inertia
    rotation_low: Array  # (3, 3)
    rotation_high: Array
    inertia_low: Array  # (3, 3)
    inertia_high: Array


def _bound_principal_remainders(
    inertia: Array, R: Array, rotations: Array, turn: Array, grid_error: float
) -> _PrincipalRemainders:
    """Bound what rotation and inertia about the principal axes are off their linearisation.

    Args:
        inertia: Inertia in the body frame (3, 3).
        R: Rotation at the middle of the box.
        rotations: Rotations on a grid (G, 3, 3).
        turn: Rotation vectors from the middle to the points of the grid (G, 3).
        grid_error: Error of entries of rotations between points of the grid.
    """
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.linalg.det(axes)  # right-handed
    Q = axes.T @ R.T @ rotations @ axes
    principal_turn = skew(turn @ axes)
    rotation = Q - np.eye(3) - principal_turn
    world_inertia = Q * moments @ np.swapaxes(Q, -1, -2) - np.diag(moments)
    world_inertia -= principal_turn * (moments[None, :] - moments[:, None])
    inertia_error = 2.0 * float(np.ptp(moments)) * grid_error
    return _PrincipalRemainders(
        axes,
        moments,
        rotation.min(axis=0) - grid_error,
        rotation.max(axis=0) + grid_error,
        world_inertia.min(axis=0) - inertia_error,
        world_inertia.max(axis=0) + inertia_error,
    )


def _build_grid(middle: Array, half: Array) -> Array:
    """Return a grid (G, 3) of angles in a box, with one point along sides of no width."""
    axes = [
        np.linspace(m - h, m + h, _GRID) if h > 0 else np.array([m])
        for m, h in zip(middle, half, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _linearise_rotation(R: Array, angles: Array) -> Array:
    """Return the Jacobian (3, 3) of the rotation vector from R, in the body, by the angles."""
    rates = np.einsum("ba,jbc->jac", R, _differentiate_rotation(angles))  # skew for each angle
    return np.stack([rates[:, 2, 1], rates[:, 0, 2], rates[:, 1, 0]])


def _bound_inertia(
    inertia: Array, R: Array, rotations: Array, grid_error: float
) -> tuple[Array, Array, Array, Array]:
    """Return inverse inertia and inertia in the world frame at the middle, and their errors.

    The error of the inertia is that on the grid alone.
    """
    body_inverse = np.linalg.inv(inertia)
    # Second derivatives of R J R^T are at most twice the spread of the eigenvalues of J.
    spread = np.ptp(np.linalg.eigvalsh(body_inverse))
    transposed = np.swapaxes(rotations, -1, -2)
    inverse, world_inertia = R @ body_inverse @ R.T, R @ inertia @ R.T
    inverse_error = np.abs(rotations @ body_inverse @ transposed - inverse).max(axis=0)
    inertia_error = np.abs(rotations @ inertia @ transposed - world_inertia).max(axis=0)
    return inverse, inverse_error + 2.0 * spread * grid_error, world_inertia, inertia_error


def _bound_toe_images(body: RigidBody, maps: Mapping[str, tuple[Array, float]]) -> dict[str, Array]:
    """Bound the images of the boxes of toes under linear maps.

    Args:
        body: The robot.
        maps: By name: maps on a grid (G, 3, 3), and how much further the image of a unit vector by
            maps between those of the grid may be.

    Returns:
        Lower and upper bounds (L, 3) [m], by the name followed by `_low` and `_high`.
    """
    center, toe_half = body.toe_center, body.toe_half
    max_reach = float(np.linalg.norm(np.abs(center) + toe_half, axis=1).max())
    bounds: dict[str, Array] = {}
    for name, (on_grid, error) in maps.items():
        low, high = _bound_linear_images(on_grid, center, toe_half, error * max_reach)
        bounds[f"{name}_low"], bounds[f"{name}_high"] = low, high
    return bounds


def _bound_linear_images(
    maps: Array, middle: Array, half: Array, grid_error: float
) -> tuple[Array, Array]:
    """Bound the images of boxes under linear maps.

    Args:
        maps: The maps on a grid (G, 3, 3).
        middle: Middles of the boxes (M, 3).
        half: Half width of the boxes (3,).
        grid_error: How much further images by maps between those of the grid may be.

    Returns:
        Lower and upper bounds (M, 3).
    """
    centers = np.einsum("gjk,mk->gmj", maps, middle)
    spread = np.einsum("gjk,k->gj", np.abs(maps), half)[:, None]
    return (centers - spread).min(axis=0) - grid_error, (centers + spread).max(axis=0) + grid_error


def _differentiate_rotation(angles: Array) -> Array:
    """Return the derivatives (3, 3, 3) of the rotation by each angle.

    Entries are constant, or sinusoids of each angle, so that the difference quotient over half a
    turn is exact.
    """
    forward, backward = angles + 0.5 * np.pi * np.eye(3), angles - 0.5 * np.pi * np.eye(3)
    derivatives: Array = 0.5 * (rotation_world_body(forward) - rotation_world_body(backward))
    return derivatives


def _bound_rotated_omega(
    axes: Array, grid_error: float, omega: Array, half: Array
) -> tuple[Array, Array]:
    """Bound the components (3,) of an angular velocity about rotated axes.

    Args:
        axes: The axes on a grid (G, 3, 3), as columns.
        grid_error: Error of their entries between points of the grid, for a unit vector.
        omega: Middle of the angular velocity (3,) [rad/s].
        half: Half width of the angular velocity (3,) [rad/s].

    Returns:
        Lower and upper bounds.
    """
    middle = np.einsum("gjk,j->gk", axes, omega)
    spread = np.einsum("gjk,j->gk", np.abs(axes), half)
    max_omega = float(np.linalg.norm(np.abs(omega) + half))
    margin = grid_error * max_omega + _MIN_OMEGA_MARGIN
    low = np.maximum((middle - spread).min(axis=0) - margin, -max_omega - _MIN_OMEGA_MARGIN)
    high = np.minimum((middle + spread).max(axis=0) + margin, max_omega + _MIN_OMEGA_MARGIN)
    return low, high
