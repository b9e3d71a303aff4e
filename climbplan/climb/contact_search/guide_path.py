"""The guide path: body poses from start to goal that follow the ground under the limbs.

The path leads along the points of a scan's guide, or straight. Where limbs start on ground, the
body keeps its height above the plane through what lies under its nominal stance, and its angles
follow that plane. Planes are averaged along the path, so that stairs become a ramp. Near start and
goal the path blends into the poses of the spec. Elsewhere, between walls, it is the straight way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.contact_search.suitability import GROUND_COSINE, starts_on_ground
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.windows.body_way import BodyPath
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.surfaces import Region

_SPACING = 0.02  # [m] between the points at which the ground is measured
_AVERAGED_FRACTION = 0.25  # of the stance's length, to both sides of a point of the path


@dataclass(frozen=True)
class GuidePath:
    """Body poses from start to goal, by the distance along the path."""

    distances: Array  # (S,) [m]
    com: Array  # (S, 3) [m]
    rpy: Array  # (S, 3) [rad]
    ground: tuple[Region, ...] = ()  # that the path follows; () between walls
    steepest: float = 0.0  # [rad] angle of the ground under the stance, however far bodies turn

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.distances[-1])

    def interpolate(self, distance: float) -> tuple[Array, Array]:
        """Interpolate body origin (3,) and rotation (3,) at a distance, held beyond the ends."""
        com, rpy = (
            np.array([np.interp(distance, self.distances, axis) for axis in values.T])
            for values in (self.com, self.rpy)
        )
        return com, rpy

    def place_nominal_toe(self, distance: float, stance: Array) -> Array:
        """Return where a toe (3,) stands ideally while the body is at a distance along the path.

        On ground the stance stays level, so that limbs are below the body on slopes, too.

        Args:
            distance: Distance along the path [m].
            stance: Nominal toe (3,), body frame [m].
        """
        com, rpy = self.interpolate(distance)
        if not self.ground:
            return np.asarray(com + rotation_world_body(rpy) @ stance)
        toe = com + rotation_world_body(np.array([0.0, 0.0, rpy[2]])) @ stance
        toe[2] = _measure_ground_height(self.ground, toe)
        return toe


def build_guide_path(scene: ClimbScene, inclination: float = 1.0) -> GuidePath:
    """Build the guide path of a scene.

    Args:
        scene: The scene.
        inclination: Fraction of the ground's angles that the body takes.
    """
    path = BodyPath.from_scene(scene)
    count = max(int(np.ceil(path.length / _SPACING)), 1) + 1
    distances = np.linspace(0.0, path.length, count)
    com = np.array([path.interpolate(float(distance)) for distance in distances])
    fraction = distances / max(path.length, 1e-9)
    rpy = scene.start.rpy + fraction[:, None] * (scene.goal.rpy - scene.start.rpy)
    if not starts_on_ground(scene):
        return GuidePath(distances, com, rpy)
    ground = tuple(r for r in scene.terrain.regions if r.normal[2] >= GROUND_COSINE)
    return _follow_ground(scene, GuidePath(distances, com, rpy, ground), inclination)


def _follow_ground(scene: ClimbScene, straight: GuidePath, inclination: float) -> GuidePath:
    """Return the path with heights and angles of the ground."""
    stance = scene.robot.stance_body
    distances = straight.distances
    planes = np.empty((len(distances), 3))  # height below the body, slopes along x and y
    for k, (origin, rpy) in enumerate(zip(straight.com, straight.rpy, strict=True)):
        arms = stance @ rotation_world_body(np.array([0.0, 0.0, rpy[2]])).T
        heights = [_measure_ground_height(straight.ground, origin + arm) for arm in arms]
        design = np.column_stack([np.ones(len(arms)), arms[:, :2]])
        planes[k] = np.linalg.lstsq(design, np.array(heights), rcond=None)[0]
    extent = max(float(np.ptp(stance[:, 1])), _SPACING)
    planes = _average_along(planes, max(int(_AVERAGED_FRACTION * extent / _SPACING), 1))
    yaw = straight.rpy[:, 2]
    limit = np.deg2rad(scene.spec.posture.rotation_limit_deg)
    # Roll is about the body's x, to the right: it lifts the nose, which points along y
    forward = -np.sin(yaw) * planes[:, 1] + np.cos(yaw) * planes[:, 2]
    sideways = np.cos(yaw) * planes[:, 1] + np.sin(yaw) * planes[:, 2]
    slopes = np.stack([np.arctan(forward), -np.arctan(sideways)], axis=-1)
    angles = np.clip(inclination * slopes, -limit, limit)
    following = straight.com.copy()
    following[:, 2] = planes[:, 0] + scene.start.com[2] - planes[0, 0]
    # Near its ends the path has their height and angles
    from_end = np.minimum(distances, distances[-1] - distances)
    weight = np.clip(from_end / min(extent, max(distances[-1] / 2, 1e-9)), 0.0, 1.0)
    is_first_half = distances < distances[-1] / 2
    correction = np.where(
        is_first_half,
        straight.com[0, 2] - following[0, 2],
        straight.com[-1, 2] - following[-1, 2],
    )
    com = following.copy()
    com[:, 2] += (1.0 - weight) * correction
    rpy = straight.rpy.copy()
    rpy[:, :2] = (1.0 - weight[:, None]) * straight.rpy[:, :2] + weight[:, None] * angles
    return GuidePath(distances, com, rpy, straight.ground, float(np.abs(slopes).max()))


def _measure_ground_height(ground: tuple[Region, ...], point: Array) -> float:
    """Return the height of the highest ground above or below a point, else of the nearest [m]."""
    highest, nearest = -np.inf, (np.inf, 0.0)
    for region in ground:
        height = float((region.offset - region.normal[:2] @ point[:2]) / region.normal[2])
        beyond = float((region.A @ np.array([point[0], point[1], height]) - region.b).max())
        if beyond <= 0:
            highest = max(highest, height)
        nearest = min(nearest, (beyond, height))
    return highest if np.isfinite(highest) else nearest[1]


def _average_along(values: Array, half_width: int) -> Array:
    """Return the moving average of values (S, C) along the path, held beyond its ends."""
    padded = np.pad(values, ((half_width, half_width), (0, 0)), mode="edge")
    width = 2 * half_width + 1
    sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), padded]), axis=0)
    return np.asarray((sums[width:] - sums[:-width]) / width)
