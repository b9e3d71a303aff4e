"""Walks from random starts as rows of a dataset (chapter 8.2.4.5): solve, write and read back.

Columns of a row:
    parameters: v_x and a_x as drawn, state and toes of the start, and the terrain and masses where
        they are drawn (`random_tasks.apply_world`).
    integers: contacts at knots 0 to N - 1.
    solution: states, toes, forces, contacts, and `section_features`. Those are the features of the
        section of five knots that begins at a knot, with the toes of the previous knot.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import PlanFileError
from climbplan.store.dataset import Dataset, DatasetFrame, build_solution_layout
from climbplan.store.dataset_row import RowAnswer
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.online.features import feature_count
from climbplan.walking.online.library import SECTION, cut_sections
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.problem.problem import build_task
from climbplan.walking.problem.random_tasks import (
    NUM_TREADS,
    SampledStart,
    StartRanges,
    WorldRanges,
    apply_world,
    sample_start,
    sample_world,
)
from climbplan.walking.schema.dataset import WalksProblemSpec
from climbplan.walking.schema.loading import WalkingRobot
from climbplan.walking.task.facts import build_facts, read_facts
from climbplan.walking.task.task import STATE, Gait, Start, WalkTask, WalkTrajectory

KIND = "mpc"


class WalkRows:
    """A source of dataset rows: draws starts and solves them."""

    def __init__(self, spec: WalksProblemSpec, robot: WalkingRobot) -> None:
        self._spec = spec
        self._task = build_task(spec.walk, robot)
        self._ranges = StartRanges(**spec.start.model_dump())
        self._world = WorldRanges(**spec.randomisation.model_dump())
        self._frame = build_frame(self._task, self._world.is_random)

    @property
    def frame(self) -> DatasetFrame:
        """Task and layouts of the dataset."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> SampledStart:
        """Draw a start within the ranges, in a random world if these are drawn."""
        return sample_world(sample_start(self._task, self._ranges, rng), self._world, rng)

    def parameters(self, sampled: SampledStart) -> Array:
        """Return the drawn parameters and the start as a row."""
        start, inputs = sampled.task.start, [sampled.forward, sampled.acceleration]
        return np.concatenate([inputs, start.state, start.toes.ravel(), sampled.world])

    def solve(self, sampled: SampledStart) -> RowAnswer:
        """Solve a start; the walk is accepted if it passes the exact check."""
        start_time = time.perf_counter()
        task, solver = sampled.task, self._spec.solver
        if solver.method == "mpcc":
            answer = solve_nlp(task, "trot", solver.time_limit)
        else:
            answer = search(task, SearchLimits(solver.time_limit, qps=solver.max_qp_solves))
        elapsed = time.perf_counter() - start_time
        trajectory = answer.trajectory
        if trajectory is None or answer.cut_short:
            return RowAnswer("limit", answer.cut_short or answer.word, time=elapsed)
        failed_checks = format_failures(check_trajectory(task, trajectory))
        if failed_checks:
            return RowAnswer("failed", f"breaks {failed_checks}", time=elapsed)
        return _build_answer(task, trajectory, answer, elapsed, self._world.is_random)


def _build_answer(
    task: WalkTask,
    trajectory: WalkTrajectory,
    answer: WalkAnswer,
    elapsed: float,
    include_world: bool,
) -> RowAnswer:
    """Return the row of a feasible walk."""
    solution = {
        "state": trajectory.state,
        "toes": trajectory.toes,
        "force": trajectory.force,
        "contact": trajectory.gait.contact.astype(np.int64),
        "section_features": cut_sections(task, trajectory, 0).features,
    }
    if include_world:
        solution["region"] = trajectory.gait.region
    return RowAnswer(
        "feasible",
        solution=solution,
        integers=trajectory.gait.contact[:-1].astype(np.int64).ravel(),
        objective=answer.objective,
        time=elapsed,
    )


def build_frame(task: WalkTask, include_world: bool) -> DatasetFrame:
    """Return the frame of all rows of a task: column names, layouts and facts.

    Args:
        task: the walking task.
        include_world: each row has a random world.
    """
    legs, N = task.body.leg_names, task.knots
    state = [f"{name}_{a}" for name in ("com", "velocity", "angle", "spin") for a in "xyz"]
    toes = [f"{leg}_toe_{a}" for leg in legs for a in "xyz"]
    names = [f"{what}_{side}" for what in ("tread", "height") for side in ("ahead", "behind")]
    treads = [f"{name}_{k + 1}" for name in names for k in range(NUM_TREADS)]
    world = ("mass_factor", "speed_factor", *treads) if include_world else ()
    layouts = {
        "state": build_solution_layout((N + 1, STATE), "m, m/s, rad, rad/s", "world"),
        "toes": build_solution_layout((N + 1, len(legs), 3), "m", "world"),
        "force": build_solution_layout((N + 1, len(legs), 3), "N", "world"),
        "contact": build_solution_layout((N + 1, len(legs)), kind="int"),
        "section_features": build_solution_layout((N - SECTION + 1, feature_count(len(legs)))),
    }
    if include_world:
        layouts["region"] = build_solution_layout((N + 1, len(legs)), kind="int")
    return DatasetFrame(
        kind=KIND,
        problem=f"{task.body.name}, {N} knots",
        facts=build_facts(task),
        parameter_names=("forward", "acceleration", *state, *toes, *world),
        integer_names=tuple(f"contact_{n}_{leg}" for n in range(N) for leg in legs),
        layouts=layouts,
    )


def read_frame_task(frame: DatasetFrame, path: Path) -> WalkTask:
    """Return the task for which a dataset's starts were drawn.

    Raises:
        PlanFileError: the facts are not those of a walking task.
    """
    try:
        task = read_facts(frame.facts)
        same = frame in (
            build_frame(task, include_world=False),
            build_frame(task, include_world=True),
        )
    except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
        raise PlanFileError(f"{path}: facts are not those of a walking task: {error}") from error
    if not same:
        raise PlanFileError(f"{path}: its columns are not those of walks")
    return task


def read_walk(task: WalkTask, data: Dataset, row: int) -> tuple[WalkTask, WalkTrajectory]:
    """Return a row's task, with its start and world, and its walk."""
    state, toes, world = np.split(
        data.parameters[row, 2:], [STATE, STATE + 3 * task.body.leg_count]
    )
    solution = data.solution
    contact = solution["contact"][row] == 1
    region = solution["region"][row] if len(world) else np.zeros(contact.shape, np.int64)
    row_task = apply_world(replace(task, start=Start(state, toes.reshape(-1, 3))), world)
    trajectory = WalkTrajectory(
        solution["state"][row],
        solution["toes"][row],
        solution["force"][row],
        Gait(contact, region),
    )
    return row_task, trajectory
