"""Terrain as flat patches near the climb: what figures and the page draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.plans.climb_plan import ClimbPlan
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Surface, Tube

MARGIN = 0.15  # [m] terrain drawn beyond the climb
TUBE_SIDES = 48
_ON_FACE = 1e-6  # [m]


@dataclass(frozen=True)
class Box:
    """Axis-aligned box."""

    lower: Array  # (3,) [m]
    upper: Array  # (3,) [m]

    def halfspaces(self) -> tuple[Array, Array]:
        """Rows A (6, 3) and b (6,) of {x : A x <= b}."""
        return np.vstack([np.eye(3), -np.eye(3)]), np.concatenate([self.upper, -self.lower])

    @property
    def size(self) -> Array:
        """Edge lengths (3,) [m]."""
        return self.upper - self.lower


@dataclass(frozen=True)
class Patch:
    """A flat convex polygon with an outside."""

    vertices: Array  # (V, 3) [m]
    normal: Array  # (3,) unit, away from the material


def limb_points(plan: ClimbPlan, com: Array, rpy: Array, angles: Array) -> Array:
    """Shoulder, femur joint, knee and toe in the world, (..., N, 4, 3) [m].

    com, rpy: (..., 3); angles: (..., N, 3) [rad].
    """
    body = joint_points_body(plan.robot, angles)
    rotation = rotation_world_body(rpy)
    return com[..., None, None, :] + np.einsum("...ij,...nkj->...nki", rotation, body)


def hull_points(plan: ClimbPlan, com: Array, rpy: Array) -> Array:
    """Corners (..., 8, 3) of the body's box in the world [m] for poses (..., 3)."""
    rotation = rotation_world_body(rpy)
    return com[..., None, :] + np.einsum("...ij,kj->...ki", rotation, plan.robot.body_hull)


def shoulder_ring(plan: ClimbPlan) -> Array:
    """Shoulders (N, 3) in the order in which they lie round the body, body frame [m]."""
    shoulders = plan.robot.shoulder_body
    around = shoulders - shoulders.mean(axis=0)
    return shoulders[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]


def climb_box(plan: ClimbPlan) -> Box:
    """Bounds of everything the robot does, with a margin [m]."""
    joints = limb_points(
        plan, plan.instants.com, plan.instants.rpy, plan.instants.joint_angles
    ).reshape(-1, 3)
    hulls = hull_points(plan, plan.rounds.com, plan.rounds.rpy).reshape(-1, 3)
    points = np.concatenate([joints, hulls, plan.rounds.toes.reshape(-1, 3)])
    return Box(points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN)


def clip(vertices: Array, box: Box) -> Array:
    """The part of a convex polygon (V, 3) inside a box: (V', 3), empty if there is none."""
    polygon = np.asarray(vertices, float)
    for row, bound in zip(*box.halfspaces(), strict=True):
        if len(polygon) == 0:
            break
        over = polygon @ row - bound
        kept: list[Array] = []
        for i in range(len(polygon)):
            j = (i + 1) % len(polygon)
            if over[i] <= 0:
                kept.append(polygon[i])
            if (over[i] < 0 < over[j]) or (over[j] < 0 < over[i]):
                t = over[i] / (over[i] - over[j])
                kept.append(polygon[i] + t * (polygon[j] - polygon[i]))
        polygon = np.array(kept).reshape(-1, 3)
    return polygon if len(polygon) >= 3 else np.empty((0, 3))


def _tube_panels(tube: Tube, box: Box) -> list[Patch]:
    """Upright strips of the tube's wall between the box's heights."""
    lower, upper = max(tube.lower, box.lower[2]), min(tube.upper, box.upper[2])
    if lower >= upper:
        return []
    angle = np.linspace(0, 2 * np.pi, TUBE_SIDES + 1)
    ring = tube.center + tube.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    panels = []
    for a, b in zip(ring[:-1], ring[1:], strict=True):
        corners = np.array([[*a, lower], [*b, lower], [*b, upper], [*a, upper]])
        inward = np.append(tube.center - (a + b) / 2, 0.0)
        panels.append(Patch(corners, inward / np.linalg.norm(inward)))
    return panels


def surface_patches(surface: Surface, box: Box) -> list[Patch]:
    """The part of a contact surface within a box, as flat patches."""
    if isinstance(surface, Tube):
        return _tube_panels(surface, box)
    if isinstance(surface, Region):
        vertices = clip(surface.vertices, box)
        return [Patch(vertices, surface.normal)] if len(vertices) else []
    raise TypeError(f"cannot draw a surface of type {type(surface).__name__}")


def solid_faces(solid: Solid, box: Box) -> list[Patch]:
    """The faces of a convex solid within a box, corners in order."""
    faces = []
    for normal, offset in zip(solid.A, solid.b, strict=True):
        corners = solid.vertices[np.abs(solid.vertices @ normal - offset) < _ON_FACE]
        if len(corners) < 3:
            continue
        around = corners - corners.mean(axis=0)
        first = around[0] / np.linalg.norm(around[0])
        second = np.cross(normal, first)
        order = np.argsort(np.arctan2(around @ second, around @ first))
        vertices = clip(corners[order], box)
        if len(vertices):
            faces.append(Patch(vertices, normal))
    return faces
