"""A time limit holds for a whole run: searches, what explains a failure, and the polish."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from walk_tasks import named, walk_task

from climbplan.errors import LimitReached
from climbplan.walking.offline import search as searching
from climbplan.walking.offline.search import SearchLimits, _IteratedLocalSearch
from climbplan.walking.offline.sqp import GaitAnswer
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.planner import planner
from climbplan.walking.schema.loading import load_mpc
from climbplan.walking.schema.solver import WalkSolverSpec, WalkTubeSpec
from climbplan.walking.task.task import STATE, WalkTask, WalkTrajectory

SPEC = Path(__file__).parents[2] / "specs" / "mpc_forward.yaml"
FOUND_NOTHING = WalkAnswer(None, np.inf, 0.0, "nothing")


@dataclass
class Solver:
    """Stands in for a method that finds nothing, each run of which takes a while."""

    takes: float  # [s]
    limits: list[float]  # [s] that it was given

    def __call__(self, task: WalkTask, solver: WalkSolverSpec, seed: int = 0) -> WalkAnswer:
        self.limits.append(solver.time_limit)
        time.sleep(self.takes)
        return FOUND_NOTHING


def planned(monkeypatch: pytest.MonkeyPatch, seconds: float) -> list[float]:
    """Limits of all runs of a walk that is not found, each of which takes 0.2 s."""
    solver = Solver(0.2, [])
    monkeypatch.setattr(planner, "solve_task", solver)
    monkeypatch.setattr(planner, "explain_slow_joints", lambda task, solve: solve(task).word)
    with pytest.raises(LimitReached):
        planner.plan_walk(load_mpc(SPEC, [f"solver.time_limit={seconds}"]))
    return solver.limits


def test_a_failure_is_explained_in_the_time_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = planned(monkeypatch, 60.0)
    assert 59.0 < first <= 60.0
    assert 0 < second < first - 0.19
    assert len(planned(monkeypatch, 0.1)) == 1  # none is left


def test_searches_before_micp_leave_it_half_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[float] = []

    def search(task: WalkTask, given: SearchLimits) -> WalkAnswer:
        limits.append(given.seconds)
        time.sleep(0.1)
        return FOUND_NOTHING

    monkeypatch.setattr(searching, "search", search)
    monkeypatch.setattr(
        "climbplan.walking.micp.solver.solve_micp",
        lambda task, given, warm, others: limits.append(given.seconds) or warm,
    )
    tube = WalkTubeSpec(seeds=2)
    planner.solve_task(
        walk_task(),
        WalkSolverSpec(method="spatial-branch-and-bound", time_limit=40.0, attitude_box=tube),
    )
    assert limits[:2] == [10.0, 10.0]
    assert 30.0 < limits[2] < 39.9


@pytest.mark.parametrize(("seconds", "polished"), [(0.0, 1), (np.inf, 5)])
def test_the_polish_begins_no_gait_after_the_limit(
    monkeypatch: pytest.MonkeyPatch, seconds: float, polished: int
) -> None:
    task = walk_task()
    gait = named("trot", task)
    knots, legs = gait.contact.shape
    toes = np.zeros((knots, legs, 3))
    trajectory = WalkTrajectory(np.zeros((knots, STATE)), toes, toes, gait)
    calls: list[int] = []

    def solve_gait(*arguments: object) -> GaitAnswer:
        calls.append(1)
        return GaitAnswer(None, np.inf, np.inf, 1, False)

    monkeypatch.setattr(searching, "warm_up", lambda task: None)
    monkeypatch.setattr(searching, "solve_gait", solve_gait)
    search = _IteratedLocalSearch(task, SearchLimits(seconds))
    search.improvements = [GaitAnswer(trajectory, float(k), 1.0, 1, True) for k in range(5)]
    assert search.polish().trajectory is None
    assert len(calls) == polished
    assert search.is_timed_out == (seconds == 0.0)
