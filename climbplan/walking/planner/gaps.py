"""Gaps between footholds: proof that no motion crosses one, and the widest on the way to a goal.

The proof. Let at least one leg stand in every interval, with its toe in its box at both ends. Then
the legs that stand before a knot and those that stand after it have their toes in boxes of the same
body. No two such toes are farther apart than the two farthest points of all boxes, whatever the
attitude. The regions stood on are therefore never farther apart from knot to knot, and at the last
knot one of them is as near to the goal as a box reaches.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import shapely
from scipy.cluster.hierarchy import DisjointSet

from climbplan.arrays import Array
from climbplan.walking.task.task import RigidBody, WalkTask

_TOLERANCE = 1e-3  # [m] more than the tolerance of the workspace checks
_FAR = np.full(2, 1e4)  # [m] beyond all ground


@dataclass(frozen=True)
class Gap:
    """The widest gap on the path between regions whose widest gap is narrowest."""

    width: float  # [m]
    near_name: str
    far_name: str
    max_width: float  # [m] that boxes allow at most, in any attitude of the body
    proved: bool  # no motion that the task allows crosses it

    def __str__(self) -> str:
        return (
            f"{self.width:.2f} m between {self.near_name} and {self.far_name}, "
            f"{self.max_width:.2f} m is what the "
            "legs' boxes allow at most"
        )


def find_widest_gap(task: WalkTask) -> Gap | None:
    """Return the widest gap on the best path from the start's toes to the goal (bottleneck path).

    Args:
        task: The task.

    Returns:
        The gap; None if there is no gap, or no goal.
    """
    ground, goal, begin = task.ground, task.goal, task.start.state[:2]
    if not goal.is_set:
        return None
    # As seen from above: heights would only make regions farther apart
    outlines = [ground.outline(k, -_FAR, _FAR)[:, :2] for k in range(ground.count)]
    shapes = np.array([shapely.polygons(outline) for outline in outlines])
    proves = task.workspace_over_stance and task.min_contacts > 0
    to_goal = shapely.distance(shapes, shapely.box(*goal.lower, *goal.upper))
    reach = compute_max_reach(task.body)
    goal_regions = np.flatnonzero(to_goal <= reach)
    if not len(goal_regions):
        last = int(np.argmin(to_goal))
        return Gap(float(to_goal[last]), ground.names[last], "the goal", reach, proves)
    distance = shapely.distance(shapes[:, None], shapes[None, :])
    first, second = np.triu_indices(ground.count, 1)
    connected = DisjointSet(range(ground.count))
    start_regions = np.unique(ground.nearest(task.start.toes[:, :2]))
    for k in np.argsort(distance[first, second], kind="stable"):
        first_region, second_region = int(first[k]), int(second[k])
        if any(
            connected.connected(start, goal_region)
            for start in start_regions
            for goal_region in goal_regions
        ):
            return None  # they touch
        connected.merge(first_region, second_region)
        if any(
            connected.connected(start, goal_region)
            for start in start_regions
            for goal_region in goal_regions
        ):
            width, max_gap = (
                float(distance[first_region, second_region]),
                compute_max_toe_distance(task.body),
            )
            if width <= _TOLERANCE:
                return None
            near_region, far_region = sorted(
                (first_region, second_region), key=lambda r: np.linalg.norm(ground.inner[r] - begin)
            )
            too_wide = proves and width > max_gap + _TOLERANCE
            return Gap(
                width, ground.names[near_region], ground.names[far_region], max_gap, too_wide
            )
    return None


def compute_max_toe_distance(body: RigidBody) -> float:
    """Return the distance of the two farthest points of all workspace boxes [m]."""
    corners = _list_workspace_corners(body)
    return float(np.linalg.norm(corners[:, None] - corners[None], axis=-1).max())


def compute_max_reach(body: RigidBody) -> float:
    """Return the largest distance of a point of a workspace box from the centre of mass [m]."""
    return float(np.linalg.norm(_list_workspace_corners(body), axis=-1).max()) + _TOLERANCE


def _list_workspace_corners(body: RigidBody) -> Array:
    """Return the corners of all workspace boxes (8 L, 3), body frame [m]."""
    signs = np.array(list(product((-1, 1), repeat=3)), float)
    result: Array = (body.toe_center[:, None] + signs * body.toe_half).reshape(-1, 3)
    return result
