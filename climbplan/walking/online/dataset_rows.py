"""Walks from random starts as rows of a dataset, and read back (chapter 8.2.4.5).

parameters: v_x and a_x as drawn, then the state and the toes of the start, then the world where one
is drawn (`draws.in_world`). integers: contacts at
knots 0 to N - 1. solution: states, toes, forces, contacts, and what a section that begins at a knot
is found by: `section_features`, with the toes of the knot before. Sections are of five knots.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import PlanFileError
from climbplan.store.dataset import Dataset, DatasetFrame, solution_layout
from climbplan.store.dataset_row import RowAnswer
from climbplan.walking.check.checker import check_trajectory, failures
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.online.features import feature_count
from climbplan.walking.online.library import SECTION, sections_of
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.problem.draws import (
    TREADS,
    DrawnStart,
    StartRanges,
    WorldRanges,
    drawn_start,
    drawn_world,
    in_world,
)
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.dataset import WalksProblemSpec
from climbplan.walking.schema.loading import WalkingRobot
from climbplan.walking.task.facts import facts_of, task_of
from climbplan.walking.task.task import STATE, Gait, Start, WalkTask, WalkTrajectory

KIND = "mpc"


class WalkRows:
    """Draws starts and solves them."""

    def __init__(self, spec: WalksProblemSpec, robot: WalkingRobot) -> None:
        self._spec = spec
        self._task = build_task(spec.walk, robot)
        self._ranges = StartRanges(**spec.start.model_dump())
        self._world = WorldRanges(**spec.world.model_dump())
        self._frame = frame_of(self._task, self._world.drawn)

    @property
    def frame(self) -> DatasetFrame:
        """Task and layouts."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> DrawnStart:
        """A start within the ranges, in a world of its own if these are drawn."""
        return drawn_world(drawn_start(self._task, self._ranges, rng), self._world, rng)

    def parameters(self, drawn: DrawnStart) -> Array:
        """What was drawn, and the start."""
        start, given = drawn.task.start, [drawn.forward, drawn.acceleration]
        return np.concatenate([given, start.state, start.toes.ravel(), drawn.world])

    def solve(self, drawn: DrawnStart) -> RowAnswer:
        """The walk, if it passes the exact check."""
        begin = time.perf_counter()
        task, solver = drawn.task, self._spec.solver
        if solver.method == "nlp":
            answer = solve_nlp(task, "trot", solver.time_limit)
        else:
            answer = search(task, SearchLimits(solver.time_limit, qps=solver.qps))
        spent = time.perf_counter() - begin
        found = answer.trajectory
        if found is None or answer.cut_short:
            return RowAnswer("limit", answer.cut_short or answer.word, time=spent)
        broken = failures(check_trajectory(task, found))
        if broken:
            return RowAnswer("failed", f"breaks {broken}", time=spent)
        return _answered(task, found, answer, spent, self._world.drawn)


def _answered(
    task: WalkTask, found: WalkTrajectory, answer: WalkAnswer, seconds: float, worlds: bool
) -> RowAnswer:
    solution = {
        "state": found.state,
        "toes": found.toes,
        "force": found.force,
        "contact": found.gait.contact.astype(np.int64),
        "section_features": sections_of(task, found, 0).features,
    }
    if worlds:
        solution["region"] = found.gait.region
    return RowAnswer(
        "feasible",
        solution=solution,
        integers=found.gait.contact[:-1].astype(np.int64).ravel(),
        objective=answer.objective,
        time=seconds,
    )


def frame_of(task: WalkTask, worlds: bool) -> DatasetFrame:
    """What rows of one task share; worlds: each row has one of its own."""
    legs, N = task.body.leg_names, task.knots
    state = [f"{part}_{a}" for part in ("com", "velocity", "angle", "spin") for a in "xyz"]
    toes = [f"{leg}_toe_{a}" for leg in legs for a in "xyz"]
    parts = [f"{what}_{side}" for what in ("tread", "height") for side in ("ahead", "behind")]
    treads = [f"{part}_{k + 1}" for part in parts for k in range(TREADS)]
    world = ("mass_factor", "speed_factor", *treads) if worlds else ()
    layouts = {
        "state": solution_layout((N + 1, STATE), "m, m/s, rad, rad/s", "world"),
        "toes": solution_layout((N + 1, len(legs), 3), "m", "world"),
        "force": solution_layout((N + 1, len(legs), 3), "N", "world"),
        "contact": solution_layout((N + 1, len(legs)), kind="int"),
        "section_features": solution_layout((N - SECTION + 1, feature_count(len(legs)))),
    }
    if worlds:
        layouts["region"] = solution_layout((N + 1, len(legs)), kind="int")
    return DatasetFrame(
        kind=KIND,
        problem=f"{task.body.name}, {N} knots",
        facts=facts_of(task),
        parameter_names=("forward", "acceleration", *state, *toes, *world),
        integer_names=tuple(f"contact_{n}_{leg}" for n in range(N) for leg in legs),
        layouts=layouts,
    )


def task_of_frame(frame: DatasetFrame, path: Path) -> WalkTask:
    """The task that starts were drawn for; raises PlanFileError for facts of something else."""
    try:
        task = task_of(frame.facts)
        same = frame in (frame_of(task, worlds=False), frame_of(task, worlds=True))
    except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
        raise PlanFileError(f"{path}: facts are not those of a walking task: {error}") from error
    if not same:
        raise PlanFileError(f"{path}: its columns are not those of walks")
    return task


def walk_of(task: WalkTask, data: Dataset, row: int) -> tuple[WalkTask, WalkTrajectory]:
    """A row's task, from its own start in its own world, and its walk."""
    state, toes, world = np.split(
        data.parameters[row, 2:], [STATE, STATE + 3 * task.body.leg_count]
    )
    solution = data.solution
    contact = solution["contact"][row] == 1
    region = solution["region"][row] if len(world) else np.zeros(contact.shape, np.int64)
    own = in_world(replace(task, start=Start(state, toes.reshape(-1, 3))), world)
    found = WalkTrajectory(
        solution["state"][row],
        solution["toes"][row],
        solution["force"][row],
        Gait(contact, region),
    )
    return own, found
