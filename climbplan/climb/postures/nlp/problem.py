"""The posture program with exact rotations as a problem that every method of the table can take."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.climb.postures.nlp.numbers import (
    JOINT_MARGINS,
    Guess,
    first_iterate,
    parameters,
    shape_of,
    variable_bounds,
)
from climbplan.climb.postures.nlp.statement import posture_trajectory
from climbplan.climb.scene import ClimbScene
from climbplan.program.polytope import Array
from climbplan.program.problem import Problem


@dataclass(frozen=True)
class PostureProblem:
    """A scene's program and the numbers at a guess, for `solve_instance(problem, theta, method)`.

    `numbers.to_rounds` makes postures of an answer, `check.check_postures` judges them.
    """

    problem: Problem
    theta: dict[str, Array]  # start (P, 1), pins (Q, M), numbers (R, 1)


def posture_problem(scene: ClimbScene, guess: Guess) -> PostureProblem:
    """The program of a scene from a guess, whose contact and free regions are pinned."""
    bounds = variable_bounds(scene, JOINT_MARGINS[0])
    program = posture_trajectory(shape_of(scene)).program(bounds=bounds)
    first = first_iterate(scene, guess, bounds)
    problem = Problem("posture", program, start=lambda theta: {"rounds": first})
    return PostureProblem(problem, parameters(scene, guess))
