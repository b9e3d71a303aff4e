"""What a two-finger gripper with spines holds (chapter 3.4), as convex cones of finger forces.

Eq. (3.2), -f^r = f^g + f^e, at each finger: the force of a finger on the hold is the gripping force
f^g, along the surface and equal and opposite on the two fingers, plus the finger's share of the
load f^e that the limb brings. With finger forces r+ and r- on the gripper, at +-(span / 2) axis
from the grip's centre, and a palm force p there,

    f = p + r+ + r-,    m = (span / 2) axis x (r+ - r-),    g = axis . (r+ - r-) / 2,

which turns (f, g, m) and (p, r+, r-) into each other for any m at right angles to the axis. Each
finger presses on a side of the hold with outward normal nu = +-cos(undercut) axis - sin(undercut) n
and the palm on the surface with normal n, all within cones that spines widen by what they hold:

    |r - (nu . r) nu| <= (mu nu . r + sigma) / S_mu,   nu . r >= 0,

sigma half of the gripper's shear force, its lower confidence bound at the hold's orientation and
friction, at each finger; none at the palm. Where a hold's sides stand up or are undercut, what the
fingers resist along them is pull-out.
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
    """Grippers on flat surfaces; a surface without a hold is gripped as the plane it is.

    Raises TypeError for surfaces that are not flat.
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
    """(R,) shear force that spines hold but for the risk, at orientations (R, 3) [N]."""
    return model.predict(np.column_stack([orientation, friction])).bound(risk)


def outside_training(grippers: Grippers) -> Array:
    """(R,) bool: orientation or friction beyond all grips that the model was fitted to."""
    state = np.column_stack([grippers.orientation, grippers.friction])
    low, high = grippers.model.state.min(axis=0), grippers.model.state.max(axis=0)
    # A grip in line with the gripper is never far from those tried about it.
    turned = np.abs(state[:, :3]).max(axis=1) > 0
    beyond = (state < low) | (state > high)
    return np.asarray(beyond[:, 3] | (beyond[:, :3].any(axis=1) & turned))


@dataclass(frozen=True)
class GripCones:
    """The cones of contacts: part 0 is the palm, 1 and 2 are the fingers."""

    normal: Array  # (..., 3, 3) unit, into free space, by part
    mu: Array  # (...)
    spines: Array  # (..., 3) sigma of each part [N]

    def excess(self, parts: Array, safety: float) -> Array:
        """Shear beyond what cones allow (..., 3) [N] for forces (..., 3, 3) on the parts."""
        pressure = self.pressure(parts)
        allowed = (self.mu[..., None] * np.maximum(pressure, 0.0) + self.spines) / safety
        return np.asarray(self.shear(parts) - allowed)

    def pressure(self, parts: Array) -> Array:
        """(..., 3) force along the parts' normals [N]."""
        return np.asarray((parts * self.normal).sum(axis=-1))

    def shear(self, parts: Array) -> Array:
        """(..., 3) force along the parts' surfaces [N]."""
        along = parts - self.pressure(parts)[..., None] * self.normal
        return np.sqrt((along**2).sum(axis=-1))


def grip_cones(normal: Array, axis: Array, undercut: Array, mu: Array, spines: Array) -> GripCones:
    """Cones for surface normals (..., 3), axes (..., 3), undercuts, mu, spines (...)."""
    across = np.cos(undercut)[..., None] * axis
    inward = np.sin(undercut)[..., None] * normal
    half = spines / 2
    return GripCones(
        normal=np.stack([normal, across - inward, -across - inward], axis=-2),
        mu=mu,
        spines=np.stack([np.zeros_like(half), half, half], axis=-1),
    )


def parts_of(
    force: Array, grip: Array, moment: Array, palm: Array, axis: Array, span: float
) -> Array:
    """Forces (..., 3, 3) on palm and fingers that are force, gripping force and moment."""
    apart = grip[..., None] * axis + np.cross(moment, axis) / span
    shared = (force - palm) / 2
    return np.stack([palm, shared + apart, shared - apart], axis=-2)


def pull_margin(cones: GripCones, parts: Array, normal: Array) -> Array:
    """(...) further pull off the surface that the fingers hold at their gripping force [N].

    The pull is shared evenly, friction counted without safety factor. Infinite where fingers do not
    slip however hard they are pulled; 0 for parts already beyond their cones.
    """
    fingers = parts[..., FIRST:, :]
    nu = cones.normal[..., FIRST:, :]
    mu, sigma = cones.mu[..., None], cones.spines[..., FIRST:]
    # A finger takes r - x n: tangential a - x b, pressure c - x d; |a - x b| = mu (c - x d) + sigma
    n = np.broadcast_to(normal[..., None, :], fingers.shape)
    d = (n * nu).sum(axis=-1)
    b = n - d[..., None] * nu
    c = (fingers * nu).sum(axis=-1)
    c = np.where(np.abs(c) < _SMALL_FORCE, 0.0, c)
    a = fingers - c[..., None] * nu
    held = mu * c + sigma
    qa = (b * b).sum(-1) - (mu * d) ** 2
    qb = (a * b).sum(-1) - mu * d * held
    qc = (a * a).sum(-1) - held**2
    inner = qb * qb - qa * qc
    with np.errstate(divide="ignore", invalid="ignore"):
        # The first x > 0 at which qa x^2 - 2 qb x + qc = 0, with qc <= 0 for a finger that holds
        slips = (qb + np.sqrt(np.maximum(inner, 0.0))) / qa
        slips = np.where(np.abs(qa) > _SMALL, slips, np.where(qb < 0, qc / (2 * qb), np.inf))
        slips = np.where((inner < 0) | (slips < 0), np.inf, slips)
        leaves = np.where(d > 0, c / d, np.inf)  # presses no more
    inside = (np.sqrt((a * a).sum(-1)) <= held + _SMALL_FORCE) & (c >= -_SMALL_FORCE)
    most = np.where(inside, np.minimum(slips, leaves), 0.0)
    return np.asarray(2 * np.maximum(most, 0.0).min(axis=-1))
