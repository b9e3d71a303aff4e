"""Gaps between footholds: what no motion crosses, and the widest on the way to a goal.

The proof. Where at least one leg stands in every interval, and standing toes are in their boxes at
both of its ends, the legs that stand before a knot and those that stand after it have their toes
within boxes of the same body: no two of these are farther apart than the two farthest points of all
boxes, whatever the attitude. So from knot to knot the regions that are stood on are never farther
apart, and at the last knot one of them is as near to the goal as a box reaches.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import shapely
from scipy.cluster.hierarchy import DisjointSet

from climbplan.arrays import Array
from climbplan.walking.task.task import RigidBody, WalkTask

_TOLERANCE = 1e-3  # [m] that checks let toes be out of their boxes, with room to spare
_FAR = np.full(2, 1e4)  # [m] beyond all ground


@dataclass(frozen=True)
class Gap:
    """The widest gap of the way that has the least wide one."""

    width: float  # [m]
    near: str
    far: str
    most: float  # [m] that boxes allow at most, in any attitude of the body
    proved: bool  # no motion that the task allows crosses it

    def __str__(self) -> str:
        return (
            f"{self.width:.2f} m between {self.near} and {self.far}, {self.most:.2f} m is what the "
            "legs' boxes allow at most"
        )


def widest_gap(task: WalkTask) -> Gap | None:
    """Of the best way from the start's toes to the goal; None if there is no gap, or no goal."""
    ground, goal, begin = task.ground, task.goal, task.start.state[:2]
    if not goal.stated:
        return None
    # As seen from above: heights would only make regions farther apart
    outlines = [ground.outline(k, -_FAR, _FAR)[:, :2] for k in range(ground.count)]
    shapes = np.array([shapely.polygons(outline) for outline in outlines])
    proves = task.whole_stance and task.least_contacts > 0
    to_goal = shapely.distance(shapes, shapely.box(*goal.lower, *goal.upper))
    reach = farthest_reach(task.body)
    ends = np.flatnonzero(to_goal <= reach)
    if not len(ends):
        last = int(np.argmin(to_goal))
        return Gap(float(to_goal[last]), ground.names[last], "the goal", reach, proves)
    apart = shapely.distance(shapes[:, None], shapes[None, :])
    one, other = np.triu_indices(ground.count, 1)
    joined = DisjointSet(range(ground.count))
    begins = np.unique(ground.nearest(task.start.toes[:, :2]))
    for k in np.argsort(apart[one, other], kind="stable"):
        a, b = int(one[k]), int(other[k])
        if any(joined.connected(start, end) for start in begins for end in ends):
            return None  # they touch
        joined.merge(a, b)
        if any(joined.connected(start, end) for start in begins for end in ends):
            width, most = float(apart[a, b]), farthest_apart(task.body)
            if width <= _TOLERANCE:
                return None
            near, far = sorted((a, b), key=lambda r: np.linalg.norm(ground.inner[r] - begin))
            too_wide = proves and width > most + _TOLERANCE
            return Gap(width, ground.names[near], ground.names[far], most, too_wide)
    return None


def farthest_apart(body: RigidBody) -> float:
    """The two farthest points of all workspace boxes [m]."""
    corners = _corners(body)
    return float(np.linalg.norm(corners[:, None] - corners[None], axis=-1).max())


def farthest_reach(body: RigidBody) -> float:
    """The point of all workspace boxes that is farthest from the centre of mass [m]."""
    return float(np.linalg.norm(_corners(body), axis=-1).max()) + _TOLERANCE


def _corners(body: RigidBody) -> Array:
    """(32, 3) body frame [m]."""
    signs = np.array(list(product((-1, 1), repeat=3)), float)
    result: Array = (body.toe_center[:, None] + signs * body.toe_half).reshape(-1, 3)
    return result
