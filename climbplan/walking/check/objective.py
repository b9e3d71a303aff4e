"""The objective of eq. (8.30), knot by knot: the checker's own."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.task.task import WalkTask


def objective_terms(task: WalkTask, state: Array, force: Array) -> dict[str, float]:
    """Each term by name. state (N + 1, 12); force (N + 1, L, 3), of which the last is not used."""
    weights, wanted = task.weights, task.reference
    terms = dict.fromkeys(("velocity", "angles", "height", "motion", "force_difference"), 0.0)
    for n in range(task.knots):
        position, velocity, angles = np.split(state[n + 1, :9], 3)
        terms["velocity"] += weights.velocity @ np.square(velocity - wanted.velocity[n])
        terms["angles"] += weights.angles @ np.square(angles - wanted.euler[n])
        terms["height"] += weights.height * (position[2] - wanted.height[n]) ** 2
        terms["motion"] += weights.motion * np.sum((position - state[n, :3]) ** 2)
        pairs = (np.sum((a - b) ** 2) for a, b in combinations(force[n], 2))
        terms["force_difference"] += weights.force_difference * 2 * sum(pairs)  # in either order
    return {name: float(term) for name, term in terms.items()}
