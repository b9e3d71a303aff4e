"""Soles of flat feet, and chains that end in them.

A sole on level ground lies along the robot's heading. On another surface it is rotated by the
smallest rotation from the vertical to the surface's normal. Terrain constrains all six degrees of
freedom of a foot, so that its joints exert a force and a moment.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import rotate_by_chain
from climbplan.climb.check.anew.kinematics import require_chain, rotate
from climbplan.robots.foot import Sole
from climbplan.robots.model import Robot

_NUM_EDGES = 24  # of pyramids inside friction cones
_RESIDUAL_TOLERANCE = 1e-9  # of a wrench, by which corner forces may miss it
_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # across, along


def compute_sole_axes(sole: Sole, normal: Array) -> Array:
    """Return width axis, length axis and normal as rows (..., 3, 3) of soles on surfaces.

    normal: (..., 3) unit normals of the surfaces.
    """
    up = np.array([0.0, 0.0, 1.0])
    level_axes = rotate(np.eye(3), up, np.full(3, sole.heading))
    axis = np.cross(np.broadcast_to(up, normal.shape), normal)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    # Onto a ceiling every turn is as short: about the axis square to upright and x, as told
    axis = np.where(sine > 1e-9, axis / np.maximum(sine, 1e-300), np.array([0.0, 1.0, 0.0]))
    angle = np.arctan2(sine[..., 0], normal[..., 2])
    return rotate(level_axes, axis[..., None, :], angle[..., None])


def compute_corner_offsets(sole: Sole, axes: Array) -> Array:
    """Return vectors (..., 4, 3) from centres to corners of soles with axes (..., 3, 3) as rows
    [m].
    """
    half = _SIGNS * np.array([sole.width, sole.length]) / 2
    return np.asarray(half @ axes[..., :2, :])


def build_sole_axes(robot: Robot, axes: Array, angles: Array) -> Array:
    """Return width axis, length axis and normal as rows (..., N, 3, 3) of soles at angles (..., N,
    J).

    axes: (..., 3, 3) axes of bodies as rows.
    """
    sole = robot.sole
    assert sole is not None
    rows = np.swapaxes(sole.axes_zero, -1, -2)
    columns = [rotate_by_chain(require_chain(robot), angles, rows[:, k]) for k in range(3)]
    return np.asarray(np.stack(columns, axis=-2) @ axes[..., None, :, :])


def compute_pressure_centre(axes: Array, force: Array, moment: Array) -> Array:
    """Return the centre of pressure (..., 2) in sole axes, from the centre [m]; NaN without
    pressure.
    """
    local_moment = (axes @ moment[..., None])[..., 0]
    pressure = (axes[..., 2, :] * force).sum(axis=-1)
    positive_pressure = np.where(pressure > 0, pressure, np.nan)
    return np.asarray(
        np.stack([-local_moment[..., 1], local_moment[..., 0]], axis=-1)
        / positive_pressure[..., None]
    )


def measure_beyond_sole(sole: Sole, centre: Array) -> Array:
    """Return how far centres of pressure lie beyond the edges (...) [m]; negative inside."""
    return np.asarray((np.abs(centre) - np.array([sole.width, sole.length]) / 2).max(axis=-1))


def distribute_to_corners(
    sole: Sole, axes: Array, force: Array, moment: Array, mu: Array, min_wrench: float
) -> Array:
    """Return forces (..., 4, 3) at the corners with a given resultant force and moment (..., 3),
    world.

    Pressures follow bilinearly from the centre of pressure, shear from a rigid rotation of the
    foot. Where these leave the friction cones, others are returned, if there are any in pyramids of
    24 sides inside the cones.

    Args:
        sole: The sole.
        axes: (..., 3, 3) axes of soles as rows.
        force: (..., 3) resultant force [N].
        moment: (..., 3) moment about the sole's centre [N m].
        mu: (...) friction coefficients.
        min_wrench: Forces and moments below it count as none [N, N m].
    """
    max_entry = np.maximum(np.abs(force).max(axis=-1), np.abs(moment).max(axis=-1))
    is_unloaded = np.asarray(max_entry < min_wrench)
    force, moment = (
        np.where(is_unloaded[..., None], 0.0, component) for component in (force, moment)
    )
    arms = compute_corner_offsets(sole, axes)
    half = np.array([sole.width, sole.length]) / 2
    centre = compute_pressure_centre(axes, force, moment) / half
    fractions = ((1.0 + _SIGNS * centre[..., None, :]) / 2).prod(axis=-1)  # (..., 4)
    normal = axes[..., 2, :]
    pressure = (normal * force).sum(axis=-1)
    pressure_middle = (fractions[..., None] * arms).sum(axis=-2)
    lever_arms = arms - pressure_middle[..., None, :]
    normal_moment = (normal * (moment - np.cross(pressure_middle, force))).sum(axis=-1)
    inertia = (fractions * (lever_arms**2).sum(axis=-1)).sum(axis=-1)
    rotation_rate = np.divide(
        normal_moment, inertia, out=np.zeros_like(normal_moment), where=inertia > 0
    )
    rotational_shear = np.cross(normal[..., None, :], lever_arms) * rotation_rate[..., None, None]
    shear = force - pressure[..., None] * normal
    forces = fractions[..., None] * (force[..., None, :] + rotational_shear)
    shear_norm = np.linalg.norm(
        fractions[..., None] * (shear[..., None, :] + rotational_shear), axis=-1
    )
    forces[is_unloaded], shear_norm[is_unloaded] = 0.0, 0.0
    cone_violation = np.asarray(
        (shear_norm - mu[..., None] * fractions * pressure[..., None]).max(axis=-1)
    )
    for index_row in np.argwhere(
        ~(cone_violation <= 0) & ~is_unloaded & np.isfinite(force).all(axis=-1)
    ):
        index = tuple(index_row)
        feasible = _find_feasible_corner_forces(
            axes[index], arms[index], force[index], moment[index], float(mu[index])
        )
        if feasible is not None:
            forces[index] = feasible
    return np.asarray(forces)


def _find_feasible_corner_forces(
    axes: Array, arms: Array, force: Array, moment: Array, mu: float
) -> Array | None:
    """Return corner forces (4, 3) in pyramids by non-negative least squares, or None."""
    angle = 2 * np.pi * np.arange(_NUM_EDGES) / _NUM_EDGES
    level = np.cos(angle)[:, None] * axes[0] + np.sin(angle)[:, None] * axes[1]
    edges = axes[2] + mu * level  # (E, 3)
    columns = np.concatenate(
        [np.hstack([edges, np.cross(arm, edges)]) for arm in arms]
    ).T  # (6, 4 E)
    wrench = np.concatenate([force, moment])
    wrench_norm = float(np.linalg.norm(wrench))
    if not wrench_norm > 0:
        return None
    scale, residual = nnls(columns, wrench / wrench_norm)
    if residual > _RESIDUAL_TOLERANCE:
        return None
    return np.asarray(wrench_norm * (scale.reshape(4, _NUM_EDGES, 1) * edges).sum(axis=1))


def fit_corner_forces(sole: Sole, axes: Array, stored: Array, force: Array, moment: Array) -> Array:
    """Return corner forces (..., 4, 3) of a force and moment (..., 3), nearest to `stored` ones."""
    arms = compute_corner_offsets(sole, axes)
    rows = np.concatenate(
        [np.broadcast_to(np.eye(3), (*arms.shape, 3)), _build_cross_matrices(arms)], axis=-2
    )
    matrix = np.concatenate(np.moveaxis(rows, -3, 0), axis=-1)  # (..., 6, 12)
    stored_wrench = (matrix @ stored.reshape(*stored.shape[:-2], 12, 1))[..., 0]
    missing_wrench = np.concatenate([force, moment], axis=-1) - stored_wrench
    finite_wrench = np.where(np.isfinite(missing_wrench), missing_wrench, 0.0)
    change = (np.linalg.pinv(matrix) @ finite_wrench[..., None]).reshape(stored.shape)
    is_lost = np.asarray(np.isnan(missing_wrench).any(axis=-1))[..., None, None]
    return np.where(is_lost, np.nan, stored + change)


def _build_cross_matrices(arms: Array) -> Array:
    """Return the matrices (..., 3, 3) of r x f as a linear map of f, for arms r (..., 3)."""
    return np.stack([np.cross(arms, axis) for axis in np.eye(3)], axis=-1)
