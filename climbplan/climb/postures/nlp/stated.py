"""Postures with exact rotations as a problem of the common table: any smooth method takes it.

The same statement as method `nlp`, by scalars: rows that are affine are stated as such. Contact and
free regions are those of the guess that it starts from. Answers are judged by the exact check that
the method's own have to pass, which does not read the statement.
"""

from __future__ import annotations

from collections.abc import Mapping

from climbplan.arrays import Array
from climbplan.climb.postures.nlp.check import check_postures
from climbplan.climb.postures.nlp.numbers import (
    JOINT_MARGINS,
    Guess,
    first_iterate,
    parameters,
    shape_of,
    to_rounds,
    variable_bounds,
)
from climbplan.climb.postures.nlp.statement import posture_trajectory
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.program.problem import Problem


def posture_problem(scene: ClimbScene, guess: Guess) -> tuple[Problem, dict[str, Array]]:
    """The problem of a scene, and its parameters; `numbers.to_rounds` makes postures of a point.

    Variables of round j are com{j} (3,) [m], rpy{j} (3,) [rad], toes{j} (3 N,) [m], limb by limb,
    and the joint angles [rad] of five moments.
    """
    bounds = variable_bounds(scene, JOINT_MARGINS[0])
    program = posture_trajectory(shape_of(scene)).program(bounds=bounds)
    first = first_iterate(scene, guess, bounds)
    start = {name: program.value(name, first) for name in program.variables}

    def check(theta: object, values: Mapping[str, Array]) -> dict[str, float]:
        found = check_postures(scene, to_rounds(scene, guess, program.point(values)))
        return {v.name: 0.0 if v.holds else v.amount for v in found}

    problem = Problem("postures", program, start=lambda theta: start, check=check)
    return problem, parameters(scene, guess)
