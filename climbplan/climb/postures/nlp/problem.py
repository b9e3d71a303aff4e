"""Postures with exact rotations as a generic nonlinear problem, which any smooth method takes.

The formulation is that of method `nlp`, written for scalars; affine rows are declared as such.
Contact and free regions are those of the initial guess. Answers are judged by the exact check of
the method itself, which does not read the formulation.
"""

from __future__ import annotations

from collections.abc import Mapping

from climbplan.arrays import Array
from climbplan.climb.postures.nlp.check import check_postures
from climbplan.climb.postures.nlp.parameters import (
    JOINT_MARGINS,
    Guess,
    build_initial_point,
    build_parameters,
    build_shape,
    build_variable_bounds,
    extract_rounds,
)
from climbplan.climb.postures.nlp.statement import build_posture_trajectory
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.program.problem import Problem


def build_posture_problem(scene: ClimbScene, guess: Guess) -> tuple[Problem, dict[str, Array]]:
    """Return the problem of a scene and its parameters; `parameters.extract_rounds` gives its
    postures.

    Variables of round j are com{j} (3,) [m], rpy{j} (3,) [rad], toes{j} (3 N,) [m], limb by limb,
    and the joint angles [rad] of five moments.
    """
    bounds = build_variable_bounds(scene, JOINT_MARGINS[0])
    program = build_posture_trajectory(build_shape(scene)).program(bounds=bounds)
    initial_point = build_initial_point(scene, guess, bounds)
    start = {name: program.value(name, initial_point) for name in program.variables}

    def check(theta: object, values: Mapping[str, Array]) -> dict[str, float]:
        violations = check_postures(scene, extract_rounds(scene, guess, program.point(values)))
        return {
            violation.name: 0.0 if violation.holds else violation.amount for violation in violations
        }

    problem = Problem("postures", program, start=lambda theta: start, check=check)
    return problem, build_parameters(scene, guess)
