"""Two-finger gripper with spines (chapter 3.4): convex cones of finger forces.

Eq. (3.2), -f^r = f^g + f^e, holds at each finger. The force of a finger on the hold is the gripping
force f^g, along the surface and equal and opposite on the two fingers, plus the finger's part of
the load f^e that the limb brings. With finger forces r+ and r- on the gripper, at +-(span / 2) axis
from the grip's centre, and a palm force p there,

    f = p + r+ + r-,    m = (span / 2) axis x (r+ - r-),    g = axis . (r+ - r-) / 2,

which turns (f, g, m) and (p, r+, r-) into each other for any m at right angles to the axis. Each
finger presses on a side of the hold with outward normal nu = +-cos(undercut) axis - sin(undercut) n
and the palm on the surface with normal n. All are within cones that spines widen:

    |r - (nu . r) nu| <= (mu nu . r + sigma) / S_mu,   nu . r >= 0,

where sigma is half of the gripper's shear force at each finger, its lower confidence bound at the
hold's orientation and friction, and zero at the palm. Where a hold's sides stand up or are
undercut, the resistance of the fingers along them is pull-out.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.mechanics.gripper_model import GripperModel
from climbplan.robots.gripper import Gripper
from climbplan.terrain.holds import flat_hold
from climbplan.terrain.surfaces import Region, Surface

_SMALL = 1e-12
_SMALL_FORCE = 1e-7  # [N] rounding

PALM, FIRST, SECOND = range(3)  # parts of a gripper: palm, finger at +axis, finger at -axis


@dataclass(frozen=True)
class Grippers:
    """A robot's grippers on the R surfaces of a terrain."""

    gripper: Gripper
    model: GripperModel
    risk: float
    axis: Array  # (R, 3) unit, from one finger to the other
    undercut: Array  # (R,) [rad]
    orientation: Array  # (R, 3) [rad]
    friction: Array  # (R,)
    spines: Array  # (R,) shear force of a gripper's spines, lower confidence bound [N]


def grippers_on(
    gripper: Gripper, model: GripperModel, risk: float, surfaces: tuple[Surface, ...]
) -> Grippers:
    """Return grippers on flat surfaces; a surface without a hold is gripped as a plane.

    Raises:
        TypeError: A surface is not flat.
    """
    holds = []
    for surface in surfaces:
        if not isinstance(surface, Region):
            raise TypeError("grippers need flat surfaces")
        holds.append(surface.hold or flat_hold(surface.normal))
    orientation = np.array([hold.orientation for hold in holds])
    friction = np.array([surface.friction for surface in surfaces])
    return Grippers(
        gripper=gripper,
        model=model,
        risk=risk,
        axis=np.array([hold.axis for hold in holds]),
        undercut=np.array([hold.undercut for hold in holds]),
        orientation=orientation,
        friction=friction,
        spines=spine_bound(model, risk, orientation, friction),
    )


def spine_bound(model: GripperModel, risk: float, orientation: Array, friction: Array) -> Array:
    """Return the shear force (R,) that spines hold except for the risk [N].

    orientation: (R, 3) [rad]; friction: (R,).
    """
    return model.predict(np.column_stack([orientation, friction])).bound(risk)


def outside_training(grippers: Grippers) -> Array:
    """Return whether orientation or friction lies outside of the model's training data, (R,)."""
    state = np.column_stack([grippers.orientation, grippers.friction])
    low, high = grippers.model.state.min(axis=0), grippers.model.state.max(axis=0)
    # A grip in line with the gripper is never far from the training data about it.
    is_rotated = np.abs(state[:, :3]).max(axis=1) > 0
    beyond = (state < low) | (state > high)
    return np.asarray(beyond[:, 3] | (beyond[:, :3].any(axis=1) & is_rotated))


@dataclass(frozen=True)
class GripCones:
    """The friction cones of contacts: part 0 is the palm, 1 and 2 are the fingers."""

    normal: Array  # (..., 3, 3) unit, into free space, by part
    mu: Array  # (...)
    spines: Array  # (..., 3) sigma of each part [N]

    def excess(self, forces: Array, safety: float) -> Array:
        """Return the shear beyond the cones (..., 3) [N] for forces (..., 3, 3) on the parts."""
        pressure = self.pressure(forces)
        allowed = (self.mu[..., None] * np.maximum(pressure, 0.0) + self.spines) / safety
        return np.asarray(self.shear(forces) - allowed)

    def pressure(self, forces: Array) -> Array:
        """Return the force along the parts' normals (..., 3) [N]."""
        return np.asarray((forces * self.normal).sum(axis=-1))

    def shear(self, forces: Array) -> Array:
        """Return the force along the parts' surfaces (..., 3) [N]."""
        tangential = forces - self.pressure(forces)[..., None] * self.normal
        return np.sqrt((tangential**2).sum(axis=-1))


def grip_cones(normal: Array, axis: Array, undercut: Array, mu: Array, spines: Array) -> GripCones:
    """Build cones for surface normals (..., 3), axes (..., 3), undercuts, mu and spines (...)."""
    across = np.cos(undercut)[..., None] * axis
    inward = np.sin(undercut)[..., None] * normal
    half = spines / 2
    return GripCones(
        normal=np.stack([normal, across - inward, -across - inward], axis=-2),
        mu=mu,
        spines=np.stack([np.zeros_like(half), half, half], axis=-1),
    )


def split_into_parts(
    force: Array, grip: Array, moment: Array, palm: Array, axis: Array, span: float
) -> Array:
    """Split force, gripping force and moment into forces (..., 3, 3) on palm and fingers."""
    opposite = grip[..., None] * axis + np.cross(moment, axis) / span
    half = (force - palm) / 2
    return np.stack([palm, half + opposite, half - opposite], axis=-2)


def pull_margin(cones: GripCones, forces: Array, normal: Array) -> Array:
    """Return the further pull off the surface that fingers hold at their gripping force [N].

    The pull is divided evenly, with friction without safety factor. Infinite where fingers never
    slip;
    0 for forces already beyond their cones.

    Args:
        cones: Cones of contacts (...).
        forces: On palm and fingers (..., 3, 3) [N].
        normal: Unit normals (..., 3) of the surfaces.
    """
    fingers = forces[..., FIRST:, :]
    nu = cones.normal[..., FIRST:, :]
    mu, sigma = cones.mu[..., None], cones.spines[..., FIRST:]
    # A finger takes r - x n: tangential a - x b, pressure c - x d; |a - x b| = mu (c - x d) + sigma
    n = np.broadcast_to(normal[..., None, :], fingers.shape)
    d = (n * nu).sum(axis=-1)
    b = n - d[..., None] * nu
    c = (fingers * nu).sum(axis=-1)
    c = np.where(np.abs(c) < _SMALL_FORCE, 0.0, c)
    a = fingers - c[..., None] * nu
    max_shear = mu * c + sigma
    qa = (b * b).sum(-1) - (mu * d) ** 2
    qb = (a * b).sum(-1) - mu * d * max_shear
    qc = (a * a).sum(-1) - max_shear**2
    inner = qb * qb - qa * qc
    with np.errstate(divide="ignore", invalid="ignore"):
        # The first x > 0 at which qa x^2 - 2 qb x + qc = 0, with qc <= 0 for a finger that holds
        slips = (qb + np.sqrt(np.maximum(inner, 0.0))) / qa
        slips = np.where(np.abs(qa) > _SMALL, slips, np.where(qb < 0, qc / (2 * qb), np.inf))
        slips = np.where((inner < 0) | (slips < 0), np.inf, slips)
        leaves = np.where(d > 0, c / d, np.inf)  # presses no more
    inside = (np.sqrt((a * a).sum(-1)) <= max_shear + _SMALL_FORCE) & (c >= -_SMALL_FORCE)
    max_pull = np.where(inside, np.minimum(slips, leaves), 0.0)
    return np.asarray(2 * np.maximum(max_pull, 0.0).min(axis=-1))
