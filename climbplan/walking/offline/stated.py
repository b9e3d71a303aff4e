"""A walk as a problem of the common table: any method that holds smooth rows takes it.

The same statement as method `nlp`, by scalars: contacts are binaries, rows that are affine are
stated as such. Regions are those of the gait that it starts from. Answers are judged by the
checker of walks, which does not read the statement.
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
    """The problem of a task, and its parameters; it starts from the guessed gait's best phase.

    Raises UsageError where no phase of the gait keeps as many legs standing as asked for.
    """
    first = next(generate_guesses(task, guess), None)
    if first is None:
        raise UsageError(f"no phase of {guess!r} keeps {task.min_contacts} legs standing")
    gait, at = first
    start = build_variables(task, gait, at)

    def check(theta: object, values: Mapping[str, Array]) -> dict[str, float]:
        found = check_trajectory(task, build_trajectory(task, gait, values))
        return {c.name: 0.0 if c.passed else c.residual - c.limit for c in found}

    program = WalkNlp(NlpShape.of(task)).stated.program()
    problem = Problem("walk", program, start=lambda theta: start, check=check)
    return problem, build_parameters(task, gait, at)


def build_trajectory(task: WalkTask, start: Gait, values: Mapping[str, Array]) -> WalkTrajectory:
    """The walk that values of the variables say, on the regions of the gait that it started from.

    values: by variable, in order of statement. Raises ValueError where they do not fit the task.
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
