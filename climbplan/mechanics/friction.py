"""Coulomb friction at point contacts: cones, inscribed pyramids, critical coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class ContactFrame:
    """Right-handed frames of contacts."""

    normal: Array  # (..., 3) unit, from the surface into free space
    tangent: Array  # (..., 3) unit
    bitangent: Array  # (..., 3) unit, normal x tangent

    @property
    def axes(self) -> Array:
        """Rows normal, tangent, bitangent, (..., 3, 3)."""
        return np.stack([self.normal, self.tangent, self.bitangent], axis=-2)


def contact_frame(normal: Array) -> ContactFrame:
    """Return frames for unit normals (..., 3): the bitangent as upright as the surface allows.

    On a level surface, where no tangent is upright, the frame follows the world's x axis.
    """
    level = np.abs(normal[..., 2:]) > 1 - 1e-9
    reference = np.where(level, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    tangent = np.cross(reference, normal)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    return ContactFrame(normal, tangent, np.cross(normal, tangent))


@dataclass(frozen=True)
class ContactForce:
    """Contact forces split along and across the surface normal."""

    normal: Array  # (...) pressure, n . f [N]
    tangential: Array  # (..., 3) [N]
    shear: Array  # (...) length of the tangential part [N]


def split_force(force: Array, normal: Array) -> ContactForce:
    """Split forces (..., 3) into normal and tangential parts on surfaces with normals (..., 3)."""
    pressure = np.einsum("...i,...i->...", force, normal)
    tangential = force - pressure[..., None] * normal
    return ContactForce(pressure, tangential, np.sqrt((tangential**2).sum(axis=-1)))


def critical_friction(force: Array, normal: Array) -> Array:
    """Return the smallest friction coefficient |f_t| / f_n that holds each force (..., 3).

    0 where there is no force at all, infinite where the force pulls or only shears.
    """
    split = split_force(force, normal)
    loaded = split.shear > 0
    critical = np.full(split.shear.shape, np.inf)
    np.divide(split.shear, split.normal, out=critical, where=loaded & (split.normal > 0))
    return np.where(loaded | (split.normal < 0), critical, 0.0)


def project_to_cone(force: Array, normal: Array, mu: Array) -> Array:
    """Shorten the tangential part of forces (..., 3) until |f_t| <= mu n . f >= 0.

    mu: (...). This is not the nearest point of the cone: only the shear changes, except where a
    force
    pulls on the surface. It removes rounding errors of friction.
    """
    split = split_force(force, normal)
    pressure = np.maximum(split.normal, 0.0)
    allowed = mu * pressure
    factor = np.ones_like(allowed)
    np.divide(allowed, split.shear, out=factor, where=split.shear > allowed)
    return np.asarray(pressure[..., None] * normal + factor[..., None] * split.tangential)


def regular_corners(count: int) -> Array:
    """Return angles (count,) of a regular polygon's corners, from the tangent [rad]."""
    return 2 * np.pi * np.arange(count) / count


def pyramid_rows(mu: Array, corners: Array) -> Array:
    """Return rows a with a . (n . f, t . f, b . f) <= 0 for a pyramid in the friction cone.

    Args:
        mu: Friction coefficient (...): the cone is |f_t| <= mu n . f.
        corners: Increasing angles (..., F) of the polygon's corners within one turn, from the
            tangent
            [rad].

    Returns:
        The rows (..., F, 3). Every corner lies on the cone, so a force inside the pyramid is inside
        the cone.
    """
    following = np.concatenate([corners[..., 1:], corners[..., :1] + 2 * np.pi], axis=-1)
    middle, half = (corners + following) / 2, (following - corners) / 2
    rows = np.empty((*corners.shape, 3))
    rows[..., 0] = -mu[..., None] * np.cos(half)
    rows[..., 1] = np.cos(middle)
    rows[..., 2] = np.sin(middle)
    return rows
