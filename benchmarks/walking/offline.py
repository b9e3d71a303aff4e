"""Offline methods: search and NLP on the shipped tasks, and the NLP from random starts."""

from __future__ import annotations

import time
from functools import partial
from typing import TextIO

import numpy as np

from benchmarks.walking.shipped_tasks import FORMS, TASKS, shipped, shipped_task
from benchmarks.walking.workers import in_order
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.problem.problem import build_task
from climbplan.walking.problem.random_tasks import StartRanges, sample_start
from climbplan.walking.task.task import WalkTask

PUBLISHED_NLP = 1.34  # [s] Table 8.6, when feasible, i7-12800H
_STARTS, _QUICK = 100, 10
_WHOLE = 30  # of them as shipped: what does not hold tries all gaits, 20 s of processor time
_SECONDS = 60.0
_RANGES = {
    "published ranges": StartRanges(),
    "and disturbances": StartRanges(lateral=0.5, tilt=0.1, angular_velocity=0.6, toes=0.04),
}


def offline_tables(seed: int, quick: bool, jobs: int, stream: TextIO) -> None:
    """Print what both methods find on the shipped tasks, then the NLP from random starts."""
    print(
        "task             form       nlp cost  CPU [s] | search cost   QPs  CPU [s]  to nlp",
        file=stream,
    )
    tasks = [(name, form) for name in (TASKS[:1] if quick else TASKS) for form in FORMS]
    for row in in_order(partial(_task, seed), tasks, jobs):
        print(row, file=stream, flush=True)
    print(
        "mpcc from random starts: v_x within 1.5 m/s, a_x within 15 m/s^2 through a knot before\n"
        "starts               form       count  success  CPU median [ms]   95 %   most  "
        "to published 1.34 s",
        file=stream,
    )
    starts = [(title, form) for title in _RANGES for form in FORMS]
    for row in in_order(partial(_starts, seed, quick), starts, jobs):
        print(row, file=stream, flush=True)


def _task(seed: int, which: tuple[str, str]) -> str:
    """The line of a task in a form."""
    name, form = which
    loaded = shipped(name, *FORMS[form])
    task = build_task(loaded.spec, loaded.robot, loaded.source)
    solve_nlp(task, "trot", _SECONDS)  # compiles the program
    from_trot, spent = _timed_nlp(task)
    begin = time.process_time()
    found = search(task, SearchLimits(_SECONDS, seed=seed, qps=loaded.spec.solver.max_qp_solves))
    searched = time.process_time() - begin
    return (
        f"{name:<16} {form:<9} {_cost(task, from_trot):>9}  {spent:7.2f} | "
        f"{_cost(task, found):>11} {found.qps:5d}  {searched:7.2f}  "
        f"{found.objective / from_trot.objective:6.3f}"
    )


def _starts(seed: int, quick: bool, which: tuple[str, str]) -> str:
    """The line of random starts in a form."""
    title, form = which
    count = _QUICK if quick else _STARTS
    task = shipped_task("mpc_forward", *FORMS[form])
    solve_nlp(task, "trot", _SECONDS)  # compiles the program
    starts = min(count, _WHOLE) if form == "shipped" else count
    times, good = np.zeros(starts), 0
    for k in range(starts):
        drawn = sample_start(task, _RANGES[title], np.random.default_rng([seed, k])).task
        answer, times[k] = _timed_nlp(drawn)
        good += _holds(drawn, answer)
    median, most95, most = np.percentile(times, [50, 95, 100])
    return (
        f"{title:<20} {form:<9} {starts:6d} {100 * good / starts:6.0f} %  "
        f"{1e3 * median:15.0f}  {1e3 * most95:5.0f}  {1e3 * most:5.0f}  "
        f"{median / PUBLISHED_NLP:19.3f} x"
    )


def _timed_nlp(task: WalkTask) -> tuple[WalkAnswer, float]:
    begin = time.process_time()
    answer = solve_nlp(task, "trot", _SECONDS)
    return answer, time.process_time() - begin


def _holds(task: WalkTask, answer: WalkAnswer) -> bool:
    """Judged by the exact check, whatever the solver says."""
    found = answer.trajectory
    return found is not None and not format_failures(check_trajectory(task, found))


def _cost(task: WalkTask, answer: WalkAnswer) -> str:
    if not _holds(task, answer):
        return "none" if answer.trajectory is None else "broken"
    return f"{answer.objective:.2f}"
