"""A walk as a problem of the common table, for any method that takes smooth rows.

It is the formulation of method `mpcc`, by scalars: contacts are binaries, and affine rows are
stated as such. Regions are those of the gait that it starts from. The checker of walks, which does
not read the formulation, evaluates the answers.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.problem import Problem
from climbplan.walking.check.checker import check_trajectory
from climbplan.walking.kernels.swept_terrain import compute_swing_heights
from climbplan.walking.offline.footing import build_gait
from climbplan.walking.offline.nlp import generate_guesses
from climbplan.walking.offline.nlp_program import (
    NlpShape,
    WalkNlp,
    build_parameters,
    build_variables,
    split_variables,
)
from climbplan.walking.task.task import Gait, WalkTask, WalkTrajectory


def walk_problem(task: WalkTask, guess: str = "trot") -> tuple[Problem, dict[str, Array]]:
    """Return the problem of a task and its parameters, started from a guessed gait's best phase.

    Args:
        task: The task.
        guess: Name of the gait.

    Raises:
        UsageError: no phase of the gait keeps `min_contacts` legs standing.
    """
    guessed = next(generate_guesses(task, guess), None)
    if guessed is None:
        raise UsageError(f"no phase of {guess!r} keeps {task.min_contacts} legs standing")
    gait, iterate = guessed
    start = build_variables(task, gait, iterate)

    def check(theta: object, values: Mapping[str, Array]) -> dict[str, float]:
        checks = check_trajectory(task, build_trajectory(task, gait, values))
        return {c.name: 0.0 if c.passed else c.residual - c.limit for c in checks}

    program = WalkNlp(NlpShape.of(task)).formulation.program()
    problem = Problem("walk", program, start=lambda theta: start, check=check)
    return problem, build_parameters(task, gait, iterate)


def build_trajectory(task: WalkTask, start: Gait, values: Mapping[str, Array]) -> WalkTrajectory:
    """Return the walk with these values of the variables, on the regions of the start gait.

    Args:
        task: The task.
        start: The gait that the problem started from.
        values: Values by variable, in order of statement.

    Raises:
        ValueError: the values do not fit the task.
    """
    state, force, spots, relaxed = split_variables(task, np.concatenate(list(values.values())))
    states = np.vstack([task.start.state, state])
    gait = build_gait(relaxed > 0.5, start.region)
    toes = np.empty((task.knots + 1, task.body.leg_count, 3))
    toes[0] = task.start.toes
    toes[1:, :, :2] = spots
    ground = task.ground
    toes[1:, :, 2] = ground.compute_height(gait.region[1:], toes[1:, :, :2])
    clear = compute_swing_heights(toes, gait.contact, gait.region, ground.region_arrays)
    toes[1:, :, 2] += np.where(gait.contact, 0.0, clear + task.swing_clearance - toes[..., 2])[1:]
    forces = np.zeros_like(toes)
    forces[:-1] = np.where(gait.contact[:-1, :, None], force, 0.0)
    return WalkTrajectory(states, toes, forces, gait)
