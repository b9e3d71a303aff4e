"""A lower bound on the posture cost of a climb, whatever is between start and goal."""

from __future__ import annotations

import numpy as np

from climbplan.climb.scene.climb_scene import ClimbScene


def bound_posture_cost(scene: ClimbScene) -> float:
    """Return a lower bound [m^2] on the posture cost of a scene's rounds: straight lines, equal
    steps.

    The squares of M steps that cover a length l sum up to at least l^2 / M. A goal that is missed
    by d, at most its tolerance, costs W d^2 and leaves l = L - d to cover.
    """
    spec, start, goal = scene.spec, scene.start, scene.goal
    weights, num_rounds = spec.posture.weights, spec.task.round_count
    rotation_tolerance = float(np.deg2rad(spec.task.goal.rotation_tolerance_deg))
    goal_tolerance = spec.task.goal.tolerance
    toes = np.linalg.norm(goal.toes - start.toes, axis=1)
    terms = [
        (weights.goal, weights.toe, toes, goal_tolerance),
        (weights.goal_com, weights.com, np.linalg.norm(goal.com - start.com), goal_tolerance),
        (weights.goal_rotation, weights.rotation, np.abs(goal.rpy - start.rpy), rotation_tolerance),
    ]
    total = 0.0
    for w_goal, w_step, length, max_miss in terms:
        distances = np.atleast_1d(np.asarray(length, float))
        w_per_step = w_step / num_rounds
        goal_miss = np.minimum(
            np.minimum(w_per_step * distances / (w_goal + w_per_step), max_miss), distances
        )
        total += float((w_goal * goal_miss**2 + w_per_step * (distances - goal_miss) ** 2).sum())
    return total
