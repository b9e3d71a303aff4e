"""Terrain as flat patches near the climb: what figures and the page draw."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports.camera import OrthographicCamera, choose_clear_view
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Surface, Tube

MARGIN = 0.15  # [m] terrain drawn beyond the climb
TUBE_SIDES = 48
_ON_FACE = 1e-6  # [m]


@dataclass(frozen=True)
class AxisAlignedBox:
    """Axis-aligned box."""

    lower: Array  # (3,) [m]
    upper: Array  # (3,) [m]

    def solid(self) -> Solid:
        """Return the box as a solid."""
        return Solid.from_box("box", self.lower, self.upper)

    @property
    def size(self) -> Array:
        """Edge lengths (3,) [m]."""
        return self.upper - self.lower


@dataclass(frozen=True)
class SurfacePolygon:
    """A flat convex polygon with an outside."""

    vertices: Array  # (V, 3) [m]
    normal: Array  # (3,) unit, away from the material


def choose_oblique_camera(
    plan: ClimbPlan, azimuth_deg: float, elevation_deg: float
) -> OrthographicCamera:
    """Return a view of the climb from the side where its obstacles hide less of it."""
    corners = [solid.vertices for solid in plan.terrain.obstacles]
    blocks = np.concatenate(corners) if corners else np.empty((0, 3))
    return choose_clear_view(azimuth_deg, elevation_deg, plan.rounds.com, blocks)


def compute_limb_points(plan: ClimbPlan, com: Array, rpy: Array, angles: Array) -> Array:
    """Return shoulder, femur joint, knee and toe in the world, (..., N, 4, 3) [m].

    com, rpy: (..., 3); angles: (..., N, 3) [rad].
    """
    body = joint_points_body(plan.robot, angles)
    rotation = rotation_world_body(rpy)
    points: Array = com[..., None, None, :] + np.einsum("...ij,...nkj->...nki", rotation, body)
    return points


def compute_hull_points(plan: ClimbPlan, com: Array, rpy: Array) -> Array:
    """Return corners (..., H, 3) of the body's hull in the world [m] for poses (..., 3)."""
    rotation = rotation_world_body(rpy)
    corners = np.einsum("...ij,kj->...ki", rotation, plan.robot.body_hull)
    placed: Array = com[..., None, :] + corners
    return placed


def list_hull_faces(plan: ClimbPlan) -> list[SurfacePolygon]:
    """Return the faces of the body's hull, body frame."""
    return _list_faces(Solid.from_points("body", plan.robot.body_hull))


def sort_shoulders(plan: ClimbPlan) -> Array:
    """Return shoulders (N, 3) in the order in which they lie round the body, body frame [m]."""
    shoulders = plan.robot.shoulder_body
    around = shoulders - shoulders.mean(axis=0)
    return shoulders[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]


def compute_climb_box(plan: ClimbPlan) -> AxisAlignedBox:
    """Return bounds of everything the robot does, with a margin [m]."""
    joints = compute_limb_points(
        plan, plan.instants.com, plan.instants.rpy, plan.instants.joint_angles
    ).reshape(-1, 3)
    hulls = compute_hull_points(plan, plan.rounds.com, plan.rounds.rpy).reshape(-1, 3)
    points = np.concatenate([joints, hulls, plan.rounds.toes.reshape(-1, 3)])
    return AxisAlignedBox(points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN)


def clip(vertices: Array, solid: Solid) -> Array:
    """Clip a convex polygon (V, 3) to a solid: (V', 3), empty if nothing is left."""
    polygon = np.asarray(vertices, float)
    for row, bound in zip(solid.A, solid.b, strict=True):
        if len(polygon) == 0:
            break
        excess = polygon @ row - bound
        clipped: list[Array] = []
        for i in range(len(polygon)):
            j = (i + 1) % len(polygon)
            if excess[i] <= 0:
                clipped.append(polygon[i])
            if (excess[i] < 0 < excess[j]) or (excess[j] < 0 < excess[i]):
                t = excess[i] / (excess[i] - excess[j])
                clipped.append(polygon[i] + t * (polygon[j] - polygon[i]))
        polygon = np.array(clipped).reshape(-1, 3)
    return polygon if len(polygon) >= 3 else np.empty((0, 3))


def _split_tube(tube: Tube, box: AxisAlignedBox) -> list[SurfacePolygon]:
    """Return upright strips of the tube's wall between the box's heights."""
    lower, upper = max(tube.lower, box.lower[2]), min(tube.upper, box.upper[2])
    if lower >= upper:
        return []
    angle = np.linspace(0, 2 * np.pi, TUBE_SIDES + 1)
    ring = tube.center + tube.wall * np.column_stack([np.cos(angle), np.sin(angle)])
    panels = []
    for a, b in pairwise(ring):
        corners = np.array([[*a, lower], [*b, lower], [*b, upper], [*a, upper]])
        inward = np.append(tube.center - (a + b) / 2, 0.0)
        panels.append(SurfacePolygon(corners, inward / np.linalg.norm(inward)))
    return panels


def list_surface_patches(surface: Surface, box: AxisAlignedBox) -> list[SurfacePolygon]:
    """Return the part of a contact surface within a box, as flat patches."""
    if isinstance(surface, Tube):
        return _split_tube(surface, box)
    if isinstance(surface, Region):
        # Where wrists hold grippers before a wall, the wall is what is seen.
        on_wall = surface.material
        vertices = clip(on_wall, box.solid())
        return [SurfacePolygon(vertices, surface.normal)] if len(vertices) else []
    raise TypeError(f"cannot draw a surface of type {type(surface).__name__}")


def list_solid_faces(solid: Solid, box: AxisAlignedBox) -> list[SurfacePolygon]:
    """Return the faces of the part of a convex solid within a box, corners in order."""
    cut = box.solid()
    if (solid.face_distance(cut.vertices) <= 0).all():
        return []  # the box lies inside: nothing of the solid's surface is seen
    whole = [SurfacePolygon(clip(f.vertices, cut), f.normal) for f in _list_faces(solid)]
    # Where the box cuts the solid, its own faces close the gap.
    caps = [SurfacePolygon(clip(f.vertices, solid), f.normal) for f in _list_faces(cut)]
    return [face for face in (*whole, *caps) if len(face.vertices)]


def _list_faces(solid: Solid) -> list[SurfacePolygon]:
    faces = []
    for normal, offset in zip(solid.A, solid.b, strict=True):
        corners = solid.vertices[np.abs(solid.vertices @ normal - offset) < _ON_FACE]
        if len(corners) < 3:
            continue
        around = corners - corners.mean(axis=0)
        first = around[0] / np.linalg.norm(around[0])
        second = np.cross(normal, first)
        order = np.argsort(np.arctan2(around @ second, around @ first))
        faces.append(SurfacePolygon(corners[order], normal))
    return faces
