"""Body poses over the limbs that stay, where the grid of poses finds nothing that holds a robot.

A robot of many limbs braces: where its body is matters little. A quadruped stands on three legs,
and has to have its body where these hold it. For each stance set within reach, at heights along the
way, the least level shift that balances it is a cone program (`climb/gait/balance.py`).
"""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.gait.balance import balancing_shifts
from climbplan.climb.transition.footholds import Poses
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import Search
from climbplan.climb.transition.stances import stance_instants

_MOST = 800  # cone programs, of a millisecond each
_SAME = 1e-3  # [m] between poses that are looked at


def balanced_poses(scene: TransitionScene, deadline: float) -> Poses:
    """Poses that balance the stance sets of all sequences within reach, beside the straight way."""
    kinematic = Search(scene, forces=False, deadline=deadline)
    kinematic.sequences()
    share = np.linspace(0.0, 1.0, scene.spec.search.heights)
    start, goal = scene.start, scene.goal
    way = Poses(
        start.com + share[:, None] * (goal.com - start.com),
        start.rpy + share[:, None] * (goal.rpy - start.rpy),
    )
    pairs = list(itertools.product(kinematic.stances(), range(way.count)))[:_MOST]
    if not pairs:
        return Poses(np.zeros((0, 3)), np.zeros((0, 3)))
    stance: IntArray = np.array([own for own, _ in pairs], np.int64)
    number: IntArray = np.array([k for _, k in pairs], np.int64)
    lifts = stance_instants(kinematic.lab.at(way), stance, number)
    # The search's friction pyramids are inscribed in the cones of the balance
    narrower = float(np.cos(np.pi / scene.spec.force.facets))
    most = scene.spec.posture.steps.com_max
    com = way.com[number] + balancing_shifts(scene, lifts, most, narrower, follow=False)
    rows: dict[tuple[int, ...], int] = {}
    for row, place in enumerate(np.rint(com / _SAME).astype(int).tolist()):
        rows.setdefault(tuple(place), row)
    kept = sorted(rows.values())
    return Poses(com[kept], way.rpy[number[kept]])
