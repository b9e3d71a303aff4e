"""Grips from the definitions of the file format: fingers, cones, wrists, spines, all built anew.

A finger of a gripper at H, the grip's centre, sits at H +- (span / 2) axis; both together with the
palm bring the contact force, the moment about H and the gripping force that a plan states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from climbplan.arrays import Array, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.grips import GripForces, SpineModel
from climbplan.robots.gripper import Gripper
from climbplan.terrain.surfaces import Region

PARTS = ("palm", "finger +", "finger -")


@dataclass(frozen=True)
class Holds:
    """Surfaces as grippers meet them, R of them."""

    axis: Array  # (R, 3)
    undercut: Array  # (R,)
    orientation: Array  # (R, 3) [rad]
    friction: Array  # (R,)


def holds_of(plan: ClimbPlan) -> Holds:
    """Holds of a plan's surfaces; a surface that has none is a plane to both fingers."""
    axes, undercut, orientation = [], [], []
    for surface in plan.terrain.surfaces:
        hold = surface.hold if isinstance(surface, Region) else None
        if hold is not None:
            axes.append(hold.axis)
            undercut.append(hold.undercut)
            orientation.append(hold.orientation)
            continue
        normal = surface.normal if isinstance(surface, Region) else np.array([1.0, 0.0, 0.0])
        # Any direction in the plane: the one that the planner takes, for the same finger forces.
        axis = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        axes.append(axis / np.sqrt(axis @ axis))
        undercut.append(-np.pi / 2)
        orientation.append(np.zeros(3))
    friction = np.array([surface.friction for surface in plan.terrain.surfaces])
    return Holds(np.array(axes), np.array(undercut), np.array(orientation), friction)


def spine_bounds(model: SpineModel, risk: float, holds: Holds) -> Array:
    """(R,) lower confidence bound of eqs. (3.4) to (3.6) at every hold, at least zero [N]."""

    def kernel(first: Array, second: Array) -> Array:
        apart = (first[:, None] - second[None, :]) / (model.scale * model.length)
        return np.asarray(model.signal**2 * np.exp(-0.5 * (apart**2).sum(axis=-1)))

    states = np.column_stack([holds.orientation, holds.friction])
    offset = model.force.mean()
    gram = kernel(model.state, model.state) + model.noise**2 * np.eye(len(model.force))
    across = kernel(model.state, states)
    weights = np.linalg.solve(gram, np.column_stack([model.force - offset, across]))
    mean = offset + across.T @ weights[:, 0]
    explained = (across * weights[:, 1:]).sum(axis=0)
    variance = np.maximum(model.signal**2 - explained, 0.0) + model.noise**2
    return np.maximum(mean + ndtri(risk) * np.sqrt(variance), 0.0)


@dataclass(frozen=True)
class Hands:
    """What palms and fingers do at S states, N limbs."""

    pressure: Array  # (S, N, 3) by part [N]
    shear: Array  # (S, N, 3) by part [N]
    held: Array  # (S, N, 3) shear that friction and spines hold [N]
    stray: Array  # (S, N) moment about the fingers' axis, which no fingers carry [N m]

    def share(self) -> Array:
        """(S, N, 3) of what is held that is used; infinite where nothing is."""
        share = np.full(self.shear.shape, np.inf)
        np.divide(self.shear, self.held, out=share, where=self.held > 0)
        return share


def hands_at(
    force: Array,
    grips: GripForces,
    normal: Array,
    region: IntArray,
    holds: Holds,
    spines: Array,
    span: float,
) -> Hands:
    """Hands for contact forces (S, N, 3) on surfaces with normals (S, N, 3)."""
    axis = holds.axis[region]
    angle = holds.undercut[region][..., None]
    rest = force - grips.palm
    # The fingers' couple: m = span axis x (half their difference)
    half = grips.grip[..., None] * axis - np.cross(axis, grips.moment) / span
    forces = (grips.palm, rest / 2 + half, rest / 2 - half)
    faces = (
        normal,
        np.cos(angle) * axis - np.sin(angle) * normal,
        -np.cos(angle) * axis - np.sin(angle) * normal,
    )
    share = spines[region] / 2
    pressure, shear, held = [], [], []
    for part, (push, face) in enumerate(zip(forces, faces, strict=True)):
        onto = (push * face).sum(axis=-1)
        pressure.append(onto)
        shear.append(np.linalg.norm(push - onto[..., None] * face, axis=-1))
        own = share if part else 0.0 * share
        held.append(holds.friction[region] * np.maximum(onto, 0.0) + own)
    stray = np.abs((grips.moment * axis).sum(axis=-1))
    return Hands(np.stack(pressure, -1), np.stack(shear, -1), np.stack(held, -1), stray)


def gripper_frames(gripper: Gripper, link: Array, angles: Array) -> Array:
    """Rows approach, closing, and their cross product (..., 3, 3) of grippers on wrists.

    link: (..., 3, 3) rows x, y, z of the last link; angles: (..., 3) of the wrist joints [rad].
    """
    del gripper  # all wrists are alike

    def spun(vector: Array, axis: Array, angle: Array) -> Array:
        cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
        along = (vector * axis).sum(axis=-1, keepdims=True)
        return vector * cos + np.cross(axis, vector) * sin + axis * along * (1 - cos)

    x, y, z = link[..., 0, :], link[..., 1, :], link[..., 2, :]
    first, second, third = angles[..., 0], angles[..., 1], angles[..., 2]
    x, z = spun(x, y, first), spun(z, y, first)
    approach, across = spun(x, z, second), spun(y, z, second)
    closing = spun(across, approach, third)
    return np.stack([approach, closing, np.cross(approach, closing)], axis=-2)


def wrist_axes(link: Array, angles: Array) -> Array:
    """Rows: unit axes of the three wrist joints (..., 3, 3) at their angles."""
    x, y, z = link[..., 0, :], link[..., 1, :], link[..., 2, :]
    cos, sin = np.cos(angles[..., 0])[..., None], np.sin(angles[..., 0])[..., None]
    tilted_x, tilted_z = cos * x - sin * z, cos * z + sin * x
    cos, sin = np.cos(angles[..., 1])[..., None], np.sin(angles[..., 1])[..., None]
    return np.stack([y, tilted_z, cos * tilted_x + sin * y], axis=-2)
