"""The mixed-integer relaxation on the shipped tasks: bounds beside what is asked, and their tubes.

Bounds are of motions within a tube of attitudes. Whether it is wide enough is judged by motions
that the search finds from several seeds.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TextIO

import numpy as np

from climbplan.bench.walking.shipped_tasks import FORMS, TASKS, shipped
from climbplan.spec.walking.solver import WalkSolverSpec
from climbplan.walking.answer import WalkAnswer
from climbplan.walking.micp.method import limits_of, solve_micp
from climbplan.walking.micp.tube import tube_about
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.problem import build_task
from climbplan.walking.task import WalkTask

_SECONDS, _QUICK = 90.0, 6.0  # of processor time
_SEEDS, _QUICK_SEEDS = 10, 2
_LONGEST = 600.0  # of a search, by the wall's clock: its QPs end it
_ASKED = {"mpc_forward": 5, "mpc_disturbance": 10, "mpc_turn": 5, "mpc_stairs": 25}  # [%]


def bound_table(seed: int, quick: bool, stream: TextIO) -> None:
    """Print the bound of `micp` from the best of several searches, and the tube it holds within."""
    seconds, seeds = (_QUICK, _QUICK_SEEDS) if quick else (_SECONDS, _SEEDS)
    print(
        f"micp: up to {seconds:.0f} s of processor time from the best of {seeds} seeds of search, "
        "published form;\nbounds are of motions within the tube; within: seeds whose motions are\n"
        "task                cost   bound    gap  (asked)  CPU [s]  within  tube; what it lacks",
        file=stream,
    )
    for name in TASKS[:1] if quick else TASKS:
        loaded = shipped(name, *FORMS["published"])  # `micp` bounds no other
        task = build_task(loaded.spec, loaded.robot, loaded.source)
        qps = loaded.spec.solver.qps
        found = [search(task, SearchLimits(_LONGEST, seed=seed + k, qps=qps)) for k in range(seeds)]
        best = min(found, key=lambda answer: answer.objective)
        solver = loaded.spec.solver.model_copy(update={"time_limit": seconds})
        limits = replace(limits_of(solver), clock=time.process_time)
        begin = time.process_time()
        proved = solve_micp(task, limits, best)
        spent = time.process_time() - begin
        within, lacks = _against_tube(task, solver, best, found)
        bound = proved.bound or 0.0
        gap = 100.0 * (1.0 - bound / proved.objective)
        print(
            f"{name:<16} {proved.objective:7.2f} {bound:7.2f} {gap:4.0f} %  ({_ASKED[name]:2d} %)  "
            f"{spent:8.0f}  {within:2d} of {seeds:<2d} {lacks}",
            file=stream,
            flush=True,
        )


def _against_tube(
    task: WalkTask, solver: WalkSolverSpec, best: WalkAnswer, found: list[WalkAnswer]
) -> tuple[int, str]:
    """How many motions are within the tube about the best one; its widths and what it lacks."""
    assert best.trajectory is not None
    angles = np.deg2rad(solver.tube.angles_deg)
    tube = tube_about(task, best.trajectory.state, angles, np.array(solver.tube.spin))
    beyond = [tube.beyond(one.trajectory.state) for one in found if one.trajectory is not None]
    within = sum(max(a.max(), s.max()) <= 1e-9 for a, s in beyond)
    most = np.maximum(0.0, np.max([np.concatenate(pair) for pair in beyond], axis=0))
    wide = f"{_listed(solver.tube.angles_deg)} deg, {_listed(solver.tube.spin)} rad/s"
    lacks = f"{_listed(np.rad2deg(most[:3]))} deg, {_listed(most[3:])} rad/s"
    return within, f"{wide}; {lacks}"


def _listed(values: object) -> str:
    return "/".join(f"{value:.3g}" for value in np.round(np.asarray(values, float), 2))
