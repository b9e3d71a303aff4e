"""Grips from the definitions of the file format: fingers, cones, wrists and spine forces.

A finger of a gripper at H, the grip's centre, is at H +- (span / 2) axis. Both fingers and the palm
together exert the contact force, the moment about H and the gripping force of the plan.

Equation numbers are those of X. Lin (UCLA 2022).
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

PART_NAMES = ("palm", "finger +", "finger -")


@dataclass(frozen=True)
class Holds:
    """R surfaces as grippers hold them."""

    axis: Array  # (R, 3)
    undercut: Array  # (R,)
    orientation: Array  # (R, 3) [rad]
    friction: Array  # (R,)


def build_holds(plan: ClimbPlan) -> Holds:
    """Return the holds of a plan's surfaces; a surface without one is a plane to both fingers."""
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


def bound_spine_forces(model: SpineModel, risk: float, holds: Holds) -> Array:
    """Return the lower confidence bound (R,) of eqs. (3.4) to (3.6) at every hold, at least zero
    [N].

    It is the quantile `risk` of a Gaussian process regression.
    """

    def kernel(first: Array, second: Array) -> Array:
        scaled_difference = (first[:, None] - second[None, :]) / (model.scale * model.length)
        return np.asarray(model.signal**2 * np.exp(-0.5 * (scaled_difference**2).sum(axis=-1)))

    states = np.column_stack([holds.orientation, holds.friction])
    offset = model.force.mean()
    gram = kernel(model.state, model.state) + model.noise**2 * np.eye(len(model.force))
    cross_covariance = kernel(model.state, states)
    weights = np.linalg.solve(gram, np.column_stack([model.force - offset, cross_covariance]))
    mean = offset + cross_covariance.T @ weights[:, 0]
    explained_variance = (cross_covariance * weights[:, 1:]).sum(axis=0)
    variance = np.maximum(model.signal**2 - explained_variance, 0.0) + model.noise**2
    return np.maximum(mean + ndtri(risk) * np.sqrt(variance), 0.0)


@dataclass(frozen=True)
class GripForcesByPart:
    """Forces on palms and fingers at S states of N limbs."""

    pressure: Array  # (S, N, 3) by part [N]
    shear: Array  # (S, N, 3) by part [N]
    max_shear: Array  # (S, N, 3) shear that friction and spines hold [N]
    axial_moment: Array  # (S, N) moment about the fingers' axis, which no fingers carry [N m]

    def compute_shear_ratio(self) -> Array:
        """Return the ratio (S, N, 3) of shear to what is held; infinite where nothing is."""
        ratio = np.full(self.shear.shape, np.inf)
        np.divide(self.shear, self.max_shear, out=ratio, where=self.max_shear > 0)
        return ratio


def compute_part_forces(
    force: Array,
    grips: GripForces,
    normal: Array,
    region: IntArray,
    *,
    holds: Holds,
    spines: Array,
    span: float,
) -> GripForcesByPart:
    """Return the forces on palms and fingers for contact forces (S, N, 3).

    Args:
        force: (S, N, 3) contact forces [N].
        grips: The stored grips of the same states.
        normal: (S, N, 3) surface normals.
        region: (S, N) numbers of the surfaces.
        holds: Holds of all surfaces.
        spines: (R,) forces of the spines [N].
        span: Distance between the fingers [m].
    """
    axis = holds.axis[region]
    angle = holds.undercut[region][..., None]
    finger_sum = force - grips.palm
    # The fingers' couple: m = span axis x (half their difference)
    half_difference = grips.grip[..., None] * axis - np.cross(axis, grips.moment) / span
    forces = (grips.palm, finger_sum / 2 + half_difference, finger_sum / 2 - half_difference)
    faces = (
        normal,
        np.cos(angle) * axis - np.sin(angle) * normal,
        -np.cos(angle) * axis - np.sin(angle) * normal,
    )
    spine_force = spines[region] / 2
    pressure, shear, max_shear = [], [], []
    for part_index, (part_force, face_normal) in enumerate(zip(forces, faces, strict=True)):
        normal_part = (part_force * face_normal).sum(axis=-1)
        pressure.append(normal_part)
        shear.append(np.linalg.norm(part_force - normal_part[..., None] * face_normal, axis=-1))
        spine_part = spine_force if part_index else 0.0 * spine_force
        max_shear.append(holds.friction[region] * np.maximum(normal_part, 0.0) + spine_part)
    axial_moment = np.abs((grips.moment * axis).sum(axis=-1))
    return GripForcesByPart(
        np.stack(pressure, -1), np.stack(shear, -1), np.stack(max_shear, -1), axial_moment
    )


def compute_gripper_frames(gripper: Gripper, link: Array, angles: Array) -> Array:
    """Return approach, closing and their cross product as rows (..., 3, 3) of grippers on wrists.

    Args:
        gripper: The gripper; all wrists are alike.
        link: (..., 3, 3) rows x, y, z of the last link.
        angles: (..., 3) angles of the wrist joints [rad].
    """
    del gripper  # all wrists are alike

    def rotate(vector: Array, axis: Array, angle: Array) -> Array:
        cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
        axial = (vector * axis).sum(axis=-1, keepdims=True)
        return vector * cos + np.cross(axis, vector) * sin + axis * axial * (1 - cos)

    x, y, z = link[..., 0, :], link[..., 1, :], link[..., 2, :]
    first, second, third = angles[..., 0], angles[..., 1], angles[..., 2]
    x, z = rotate(x, y, first), rotate(z, y, first)
    approach, tilted_y = rotate(x, z, second), rotate(y, z, second)
    closing = rotate(tilted_y, approach, third)
    return np.stack([approach, closing, np.cross(approach, closing)], axis=-2)


def compute_wrist_axes(link: Array, angles: Array) -> Array:
    """Return the unit axes of the three wrist joints as rows (..., 3, 3) at their angles."""
    x, y, z = link[..., 0, :], link[..., 1, :], link[..., 2, :]
    cos, sin = np.cos(angles[..., 0])[..., None], np.sin(angles[..., 0])[..., None]
    tilted_x, tilted_z = cos * x - sin * z, cos * z + sin * x
    cos, sin = np.cos(angles[..., 1])[..., None], np.sin(angles[..., 1])[..., None]
    return np.stack([y, tilted_z, cos * tilted_x + sin * y], axis=-2)
