"""What the postures of a climb cost at least, whatever is between start and goal."""

from __future__ import annotations

import numpy as np

from climbplan.climb.scene.climb_scene import ClimbScene


def least_cost(scene: ClimbScene) -> float:
    """A lower bound [m^2] on the posture cost of a scene's rounds: straight ways in equal steps.

    Of M steps that cover a length l the squares sum up to l^2 / M at least. A goal missed by d, of
    which its tolerance is the most, costs W d^2 and leaves l = L - d to cover.
    """
    spec, start, goal = scene.spec, scene.start, scene.goal
    weights, m = spec.posture.weights, spec.task.round_count
    turn = float(np.deg2rad(spec.task.goal.rotation_tolerance_deg))
    far = spec.task.goal.tolerance
    toes = np.linalg.norm(goal.toes - start.toes, axis=1)
    terms = [
        (weights.goal, weights.toe, toes, far),
        (weights.goal_com, weights.com, np.linalg.norm(goal.com - start.com), far),
        (weights.goal_rotation, weights.rotation, np.abs(goal.rpy - start.rpy), turn),
    ]
    total = 0.0
    for missing, step, length, most in terms:
        way = np.atleast_1d(np.asarray(length, float))
        each = step / m
        missed = np.minimum(np.minimum(each * way / (missing + each), most), way)
        total += float((missing * missed**2 + each * (way - missed) ** 2).sum())
    return total
