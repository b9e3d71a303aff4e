"""Soles of flat feet, and chains that end in them.

A sole lies on its surface as one on level ground does, along the robot's heading, turned by the
least turn that takes upright to the surface's normal. Terrain holds all six degrees of freedom of
a foot: what its joints press with is a force and a moment.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import chain_turned
from climbplan.climb.check.anew.kinematics import chain_of, turned
from climbplan.robots.foot import Sole
from climbplan.robots.model import Robot

_EDGES = 24  # of pyramids inside friction cones
_MATCHED = 1e-9  # of a wrench, by which corner forces may miss it
_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # across, along


def lying(sole: Sole, normal: Array) -> Array:
    """Rows across, along, normal (..., 3, 3) of soles on surfaces of unit normals (..., 3)."""
    up = np.array([0.0, 0.0, 1.0])
    level = turned(np.eye(3), up, np.full(3, sole.heading))
    axis = np.cross(np.broadcast_to(up, normal.shape), normal)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    # Onto a ceiling every turn is as short: about the axis square to upright and x, as told
    axis = np.where(sine > 1e-9, axis / np.maximum(sine, 1e-300), np.array([0.0, 1.0, 0.0]))
    angle = np.arctan2(sine[..., 0], normal[..., 2])
    return turned(level, axis[..., None, :], angle[..., None])


def corners(sole: Sole, axes: Array) -> Array:
    """(..., 4, 3) from middles to corners of soles with axes (..., 3, 3) as rows [m]."""
    half = _SIGNS * np.array([sole.width, sole.length]) / 2
    return np.asarray(half @ axes[..., :2, :])


def soles_at(robot: Robot, axes: Array, angles: Array) -> Array:
    """Rows across, along, normal (..., N, 3, 3) of soles at angles (..., N, J), world.

    axes: (..., 3, 3) of bodies as rows.
    """
    sole = robot.sole
    assert sole is not None
    rows = np.swapaxes(sole.axes_zero, -1, -2)
    own = [chain_turned(chain_of(robot), angles, rows[:, k]) for k in range(3)]
    return np.asarray(np.stack(own, axis=-2) @ axes[..., None, :, :])


def centre_of_pressure(axes: Array, force: Array, moment: Array) -> Array:
    """(..., 2) across and along soles of rows axes from their middles [m]; NaN without pressure."""
    own = (axes @ moment[..., None])[..., 0]
    pressure = (axes[..., 2, :] * force).sum(axis=-1)
    safe = np.where(pressure > 0, pressure, np.nan)
    return np.asarray(np.stack([-own[..., 1], own[..., 0]], axis=-1) / safe[..., None])


def beyond_sole(sole: Sole, centre: Array) -> Array:
    """(...) how far centres of pressure lie beyond the edges [m]; below zero inside."""
    return np.asarray((np.abs(centre) - np.array([sole.width, sole.length]) / 2).max(axis=-1))


def corner_forces(
    sole: Sole, axes: Array, force: Array, moment: Array, mu: Array, least: float
) -> Array:
    """Forces (..., 4, 3) at the corners that make a force and moment (..., 3), world.

    Pressures as the centre of pressure shares them out, shear as of a foot that turns a little
    about some axis; where these leave the cones of friction coefficients mu (...), others that do
    not, if there are any in pyramids of 24 sides inside the cones. Forces and moments below `least`
    [N, N m] count as none.
    """
    largest = np.maximum(np.abs(force).max(axis=-1), np.abs(moment).max(axis=-1))
    none = np.asarray(largest < least)
    force, moment = (np.where(none[..., None], 0.0, part) for part in (force, moment))
    arms = corners(sole, axes)
    half = np.array([sole.width, sole.length]) / 2
    centre = centre_of_pressure(axes, force, moment) / half
    share = ((1.0 + _SIGNS * centre[..., None, :]) / 2).prod(axis=-1)  # (..., 4)
    normal = axes[..., 2, :]
    pressure = (normal * force).sum(axis=-1)
    middle = (share[..., None] * arms).sum(axis=-2)
    off = arms - middle[..., None, :]
    spin = (normal * (moment - np.cross(middle, force))).sum(axis=-1)
    inertia = (share * (off**2).sum(axis=-1)).sum(axis=-1)
    rate = np.divide(spin, inertia, out=np.zeros_like(spin), where=inertia > 0)
    across = np.cross(normal[..., None, :], off) * rate[..., None, None]
    shear = force - pressure[..., None] * normal
    found = share[..., None] * (force[..., None, :] + across)
    size = np.linalg.norm(share[..., None] * (shear[..., None, :] + across), axis=-1)
    found[none], size[none] = 0.0, 0.0
    over = np.asarray((size - mu[..., None] * share * pressure[..., None]).max(axis=-1))
    for place in np.argwhere(~(over <= 0) & ~none & np.isfinite(force).all(axis=-1)):
        at = tuple(place)
        other = _other_forces(axes[at], arms[at], force[at], moment[at], float(mu[at]))
        if other is not None:
            found[at] = other
    return np.asarray(found)


def _other_forces(axes: Array, arms: Array, force: Array, moment: Array, mu: float) -> Array | None:
    """(4, 3) corner forces in pyramids; None where there are none."""
    angle = 2 * np.pi * np.arange(_EDGES) / _EDGES
    level = np.cos(angle)[:, None] * axes[0] + np.sin(angle)[:, None] * axes[1]
    edges = axes[2] + mu * level  # (E, 3)
    columns = np.concatenate(
        [np.hstack([edges, np.cross(arm, edges)]) for arm in arms]
    ).T  # (6, 4 E)
    wanted = np.concatenate([force, moment])
    size = float(np.linalg.norm(wanted))
    if not size > 0:
        return None
    scale, residual = nnls(columns, wanted / size)
    if residual > _MATCHED:
        return None
    return np.asarray(size * (scale.reshape(4, _EDGES, 1) * edges).sum(axis=1))


def corners_of_wrench(sole: Sole, axes: Array, stored: Array, force: Array, moment: Array) -> Array:
    """Corner forces (..., 4, 3) of a force and moment (..., 3), nearest to `stored` ones."""
    arms = corners(sole, axes)
    rows = np.concatenate([np.broadcast_to(np.eye(3), (*arms.shape, 3)), _cross(arms)], axis=-2)
    matrix = np.concatenate(np.moveaxis(rows, -3, 0), axis=-1)  # (..., 6, 12)
    now = (matrix @ stored.reshape(*stored.shape[:-2], 12, 1))[..., 0]
    lack = np.concatenate([force, moment], axis=-1) - now
    fine = np.where(np.isfinite(lack), lack, 0.0)
    change = (np.linalg.pinv(matrix) @ fine[..., None]).reshape(stored.shape)
    lost = np.asarray(np.isnan(lack).any(axis=-1))[..., None, None]
    return np.where(lost, np.nan, stored + change)


def _cross(arms: Array) -> Array:
    """(..., 3, 3) with r x f as a matrix times f, of arms r (..., 3)."""
    return np.stack([np.cross(arms, axis) for axis in np.eye(3)], axis=-1)
