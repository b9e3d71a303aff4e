"""The objective of eq. (8.30): tracking, body motion, and differences between contact forces.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.task.task import ANGLES, POSITION, VELOCITY, WalkTask


def compute_cost_terms(task: WalkTask, state: Array, force: Array) -> dict[str, float]:
    """Return each term of the objective by name.

    Args:
        task: references and weights.
        state: (N + 1, 12) states.
        force: (N + 1, L, 3) contact forces [N]; the last is not used.
    """
    weights, reference = task.weights, task.reference
    later = state[1:]
    velocity = (later[:, VELOCITY] - reference.velocity) ** 2 @ weights.velocity
    angles = (later[:, ANGLES] - reference.euler) ** 2 @ weights.angles
    height = weights.height * (later[:, 2] - reference.height) ** 2
    motion = weights.motion * (np.diff(state[:, POSITION], axis=0) ** 2).sum()
    return {
        "velocity": float(velocity.sum()),
        "angles": float(angles.sum()),
        "height": float(height.sum()),
        "motion": float(motion),
        "force_difference": float(weights.force_difference * sum_force_differences(force[:-1])),
    }


def sum_force_differences(force: Array) -> float:
    """Return the sum over knots and pairs of legs of || f_s - f_t ||^2; force (N, L, 3) [N^2]."""
    legs = force.shape[1]
    squares = (force**2).sum()
    return float(2.0 * (legs * squares - (force.sum(axis=1) ** 2).sum()))


def compute_objective(task: WalkTask, state: Array, force: Array) -> float:
    """Return the sum of all cost terms."""
    return sum(compute_cost_terms(task, state, force).values())
