"""Random fields of stepping stones: how many are crossed, and what keeps the others."""

from __future__ import annotations

import time
from functools import partial
from typing import TextIO

import numpy as np

from benchmarks.walking.shipped_tasks import shipped, shipped_task
from benchmarks.walking.workers import in_order
from climbplan.arrays import Array
from climbplan.walking.check.checker import check_loop, check_trajectory, format_failures
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.offline.warm_up import warm_up
from climbplan.walking.online.closed_loop import LoopResult, freeze_garbage, simulate_loop
from climbplan.walking.online.controller import OnlineController
from climbplan.walking.online.library import SectionLibrary
from climbplan.walking.online.run import (
    build_scenario,
    build_settings,
    compute_library_key,
    load_library,
)
from climbplan.walking.planner.gaps import find_widest_gap
from climbplan.walking.problem.problem import build_sampled_task, build_task
from climbplan.walking.task.task import WalkTask, WalkTrajectory

SPEC = "mpc_stones"
_FIELDS, _QUICK = 50, 2
_SEARCHED = 10  # of them by `gait-search`, which takes as long as thirty of the others
_SECONDS = 120.0
_BEYOND = 0.6  # [s] longer than the horizon of an offline plan
_ONLINE = ("solver.method=online", "task.goal=null")


def stones_table(seed: int, quick: bool, jobs: int, stream: TextIO) -> None:
    """Print how many random fields are crossed by each method, and what keeps the others.

    A field is crossed if the exact check passes, goal included; online if that of the loop does and
    the body is as far as the goal at the end.
    """
    count = _QUICK if quick else _FIELDS
    print(
        f"stones: random fields of {SPEC}, to a goal beyond; online walks on at the reference\n"
        "method  fields  crossed  CPU median [s]   95 %  cost median",
        file=stream,
    )
    kept: list[str] = []
    for method, fields in (("gait-search", min(count, _SEARCHED)), ("mpcc", count)):
        found = list(in_order(partial(_field_by, method), range(seed, seed + fields), jobs))
        times = np.array([spent for spent, _, _ in found])
        costs = [cost for _, cost, _ in found if cost is not None]
        kept += [f"  {why}" for _, _, why in found if why]
        median = f"{np.median(costs):11.1f}" if costs else "       none"
        print(f"{_row(method, len(costs), times)}  {median}", file=stream, flush=True)
    kept += _online(seed, count, stream)
    if kept:
        print("fields that were not crossed:", *kept, sep="\n", file=stream)


def _field_by(method: str, number: int) -> tuple[float, float | None, str]:
    """Processor time [s], the cost if a field is crossed, and else what keeps it."""
    loaded = shipped(SPEC, _field(number))
    task = build_task(loaded.spec, loaded.robot, loaded.source)
    begin = time.process_time()
    if method == "mpcc":
        answer = solve_nlp(task, "walking trot", _SECONDS)
    else:
        answer = search(task, SearchLimits(_SECONDS, qps=loaded.spec.solver.max_qp_solves))
    spent = time.process_time() - begin
    if _holds(task, answer.trajectory):
        return spent, answer.objective, ""
    return spent, None, f"{number} by {method}: {find_widest_gap(task) or answer.word}"


def _online(seed: int, count: int, stream: TextIO) -> list[str]:
    """Print the line of `online`; what keeps fields from being crossed."""
    times, ticks = np.zeros(count), []
    kept: list[str] = []
    library: SectionLibrary | None = None
    for k in range(count):
        loaded = shipped(SPEC, _field(seed + k), *_ONLINE)
        spec, task = loaded.spec, build_task(loaded.spec, loaded.robot, loaded.source)
        if library is None:  # one for all: it is of flat ground
            warm_up(task)
            key = compute_library_key(task)
            library = load_library(task, spec.library, loaded.directory, seed, key, _silent)
        begin = time.process_time()
        controller = OnlineController(task, library, build_settings(spec))
        duration = task.knots * task.dt + _BEYOND
        with freeze_garbage():
            loop = simulate_loop(
                controller, task, duration, build_scenario(spec.loop, task), seed=seed + k
            )
        times[k] = time.process_time() - begin
        ticks += [1e3 * command.tick_time for command in loop.commands]
        asked = shipped_task(SPEC, _field(seed + k))
        if why := _kept_from(task, loop, float(asked.goal.lower[0])):
            told = [why] if (gap := find_widest_gap(asked)) is None else [why, str(gap)]
            kept.append(f"  {seed + k} online: {'; '.join(told)}")
    median, most = np.percentile(ticks, [50, 99])
    row = _row("online", count - len(kept), times)
    print(f"{row}  tick {median:.2f} ms, 99 % {most:.2f} ms", file=stream, flush=True)
    return kept


def _field(number: int) -> str:
    return f"terrain.stones.seed={number}"


def _row(method: str, crossed: int, times: Array) -> str:
    median, most = np.percentile(times, [50, 95])
    share = 100 * crossed / len(times)
    return f"{method:<7} {len(times):6d} {share:6.0f} %  {median:14.2f}  {most:5.2f}"


def _kept_from(task: WalkTask, loop: LoopResult, goal: float) -> str:
    """Why a field was not crossed online, up to an x [m]; empty if it was."""
    walk = loop.trajectory
    if loop.fall_time is not None:
        return f"fell after {loop.fall_time:.1f} s"
    if told := format_failures(
        check_loop(build_sampled_task(task, len(walk.state) - 1), walk, loop.push_velocity)
    ):
        return told
    short = goal - float(walk.state[-1, 0])
    return f"{short:.2f} m short of the goal" if short > 0 else ""


def _holds(task: WalkTask, found: WalkTrajectory | None) -> bool:
    return found is not None and not format_failures(check_trajectory(task, found))


def _silent(stage: str, fraction: float) -> None:
    pass
