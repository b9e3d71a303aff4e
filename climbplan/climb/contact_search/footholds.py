"""Candidate footholds of a limb: points of contact regions near its nominal toe.

A candidate is within the limb's joint bounds, clear of terrain and body, at all poses that the body
is expected to have while the limb stands on it. What is checked here is cheap and for many points
at once; `limb_move.py` checks the chosen one exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.limb_pairs import compute_body_distances
from climbplan.climb.clearance.limbs import INTERPOLATION_MARGIN, compute_link_clearances
from climbplan.climb.clearance.raw_surface import ToeContacts, compute_raw_shortfalls
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Remedy
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.kinematics import solve_inverse_kinematics, to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.self_clearance import list_clearance_pairs
from climbplan.terrain.nearest import beyond_bounds, bounds_of
from climbplan.terrain.surfaces import Region

_SPACING = 0.04  # [m] of the points looked at on each region
_GRID_POINTS = 3  # to each side of the nominal toe
_MAX_CANDIDATES = 40  # the nearest, which are checked
_HEIGHT_WEIGHT = 0.5  # of the distance normal to the level, beside that in it
_MIN_NORMAL_COSINE = 0.6  # between a contact's normal and that at the start
_MIN_SEARCH_RADIUS = 0.15  # [m]
_JOINT_MARGIN = np.deg2rad(1.0)  # that joints keep from their bounds, in their units
_STEP_TOLERANCE = 1e-6  # [m]
_STEP_RESERVE = 1.2  # of a step that would just be long enough


@dataclass(frozen=True)
class Foothold:
    """A place for a toe."""

    point: Array  # (3,) [m]
    region: int


@dataclass(frozen=True)
class BodyPose:
    """Position and rotation of the body."""

    com: Array  # (3,) [m]
    rpy: Array  # (3,) [rad]


class FootholdFinder:
    """Finds candidate footholds of each limb of a scene."""

    def __init__(self, scene: ClimbScene) -> None:
        self.scene = scene
        self.regions: tuple[Region, ...] = scene.standing
        self.bounds = bounds_of(self.regions)
        self.normals = np.array([region.normal for region in self.regions])  # (R, 3)
        robot = scene.robot
        zero_angles = np.zeros((1, robot.limb_count, robot.joint_count))
        pairs, _ = list_clearance_pairs(robot, limb_capsules(robot, zero_angles))
        # Of each limb the capsules that keep off the body, as of a robot with that limb alone
        self.body_pairs = [
            pairs[pairs[:, 0] == limb] * np.array([0, 1, 1, 1]) for limb in range(robot.limb_count)
        ]

    def find(
        self,
        limb: int,
        toe: Array,
        nominal: Array,
        poses: list[BodyPose],
        max_distance: float = np.inf,
    ) -> list[Foothold]:
        """Return footholds of a limb, the nearest to its nominal toe first.

        Args:
            limb: Number of the limb.
            toe: (3,) where it stands [m].
            nominal: (3,) where it stands ideally [m].
            poses: The pose of the body at which the limb moves, then those at which it stands on
                the foothold, up to the one at which it is lifted again.
            max_distance: Largest distance from the nominal toe [m].
        """
        points, regions = self._sample_points(limb, nominal)
        offset = points - nominal
        cost = np.hypot(np.linalg.norm(offset[:, :2], axis=1), _HEIGHT_WEIGHT * offset[:, 2])
        step = np.linalg.norm(points - toe, axis=1)
        max_step = self.scene.spec.posture.steps.toe_max - _STEP_TOLERANCE
        nearest = np.argsort(cost, kind="stable")
        is_allowed = (step <= max_step) & (np.linalg.norm(offset, axis=1) <= max_distance)
        nearest = nearest[is_allowed[nearest]][:_MAX_CANDIDATES]
        if not len(nearest):
            return []
        nearest = nearest[self._have_room_for_feet(points[nearest])]
        if not len(nearest):
            return []
        points, regions = points[nearest], regions[nearest]
        suitable = self._are_suitable(limb, points, self.normals[regions], poses)
        return [
            Foothold(point, int(region))
            for point, region in zip(points[suitable], regions[suitable], strict=True)
        ]

    def suggest_longer_steps(self, limb: int, toe: Array, nominal: Array) -> tuple[Remedy, ...]:
        """Return the longest step with which the limb comes near its nominal toe, if it is short.

        Arguments as of `find`.
        """
        points, _ = self._sample_points(limb, nominal)
        if not len(points):
            return ()
        nearest = points[np.argmin(np.linalg.norm(points - nominal, axis=1))]
        longest = float(np.linalg.norm(nearest - toe)) * _STEP_RESERVE
        if longest <= self.scene.spec.posture.steps.toe_max:
            return ()
        longest = round(longest, 2)
        return (Remedy(f"steps of toes up to {longest:g} m", "posture.steps.toe_max", longest),)

    def _sample_points(self, limb: int, nominal: Array) -> tuple[Array, IntArray]:
        """Return points (P, 3) near a nominal toe and their regions (P,)."""
        scene = self.scene
        radius = max(scene.robot.stance_radius, _MIN_SEARCH_RADIUS)
        start_normal = self.normals[scene.start.region[limb]]
        allowed = np.flatnonzero(
            scene.terrain.allowed[limb] & (self.normals @ start_normal >= _MIN_NORMAL_COSINE)
        )
        candidates = allowed[beyond_bounds(self.bounds[:, allowed], nominal) <= radius]
        steps = _SPACING * np.arange(-_GRID_POINTS, _GRID_POINTS + 1)
        points, regions = [np.empty((0, 3))], [np.empty(0, np.int64)]
        for number in candidates:
            region = self.regions[number]
            normal = region.normal
            first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
            first /= np.linalg.norm(first)
            tangents = np.stack([first, np.cross(normal, first)])
            foot = nominal - (normal @ nominal - region.offset) * normal
            grid = foot + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) @ tangents
            inside = (grid @ region.A.T < region.b).all(axis=1)
            places = np.concatenate([region.project(nominal)[None], grid[inside]])
            places = places[np.linalg.norm(places - nominal, axis=1) <= radius]
            points.append(places)
            regions.append(np.full(len(places), number, np.int64))
        return np.concatenate(points), np.concatenate(regions)

    def _have_room_for_feet(self, points: Array) -> BoolArray:
        """Return whether spherical feet at points (P, 3) enter nothing beside their surface."""
        foot, scan = self.scene.robot.foot, self.scene.terrain.scan
        if foot is None or scan is None:
            return np.ones(len(points), bool)
        from climbplan.scan.distances import compute_triangle_distances

        distance = compute_triangle_distances(points, points, scan.corners, foot.radius)
        return np.asarray(distance >= foot.radius - scan.flatness)

    def _are_suitable(
        self, limb: int, points: Array, normals: Array, poses: list[BodyPose]
    ) -> BoolArray:
        """Return whether the limb reaches points (P, 3) clear of everything at all poses."""
        robot, lift = self.scene.robot.one_limb(limb), self.scene.spec.trajectory.swing_clearance
        count, last = len(points), len(poses) - 1
        # Standing at all poses, and hovering at those of its moves
        places = np.concatenate(
            [np.tile(points, (len(poses), 1)), np.tile(points + lift * normals, (2, 1))]
        )
        selected = [poses[k] for k in (*range(len(poses)), 0, last)]
        com = np.repeat([pose.com for pose in selected], count, axis=0)
        rpy = np.repeat([pose.rpy for pose in selected], count, axis=0)
        margin = _JOINT_MARGIN * robot.joint_unit
        solution = solve_inverse_kinematics(robot, to_body(com, rpy, places[:, None]), None, margin)
        suitable = solution.valid[:, 0].reshape(-1, count).all(axis=0)
        links = limb_capsules(robot, solution.best())
        if len(self.body_pairs[limb]):
            clearance = compute_body_distances(robot, links, self.body_pairs[limb]).min(axis=-1)
            suitable = suitable & ~(clearance.reshape(-1, count) < 0).any(axis=0)
        standing = slice(count, len(poses) * count)  # from the pose after its own move on
        links = replace(links, starts=links.starts[standing], ends=links.ends[standing])
        links = links.to_world(com[standing], rotation_world_body(rpy[standing]))
        contacts = ToeContacts(
            places[standing][:, None, None],
            np.tile(normals, (last, 1))[:, None, None],
        )
        suitable &= self._are_clear(limb, links, contacts).reshape(last, count).all(axis=0)
        return np.asarray(suitable)

    def _are_clear(self, limb: int, links: Capsules, contacts: ToeContacts) -> BoolArray:
        """Return whether links (P, 1, C) of a limb keep their clearance from the terrain."""
        terrain = self.scene.terrain
        clear = np.ones(len(links.starts), bool)
        if terrain.scan is not None:
            missing = compute_raw_shortfalls(terrain.scan, links, contacts, INTERPOLATION_MARGIN)
            clear &= missing[:, 0] <= 1e-9
        if terrain.link_solids:
            clearance = compute_link_clearances(self.scene, links, INTERPOLATION_MARGIN, limb)
            lacking = clearance < INTERPOLATION_MARGIN - 1e-9
            clear &= ~lacking.reshape(len(clear), -1).any(axis=1)
        return clear
