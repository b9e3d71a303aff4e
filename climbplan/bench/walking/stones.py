"""Random fields of stepping stones: how many are crossed offline, and what keeps the others."""

from __future__ import annotations

import time
from typing import TextIO

import numpy as np

from climbplan.bench.walking.shipped_tasks import shipped
from climbplan.walking.check.checker import check_trajectory, failures
from climbplan.walking.gaps import widest_gap
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.problem import build_task
from climbplan.walking.task import WalkTask, WalkTrajectory

SPEC = "mpc_stones"
_FIELDS, _QUICK = 50, 2
_SECONDS = 120.0
_METHODS = ("search", "nlp")


def stones_table(seed: int, quick: bool, stream: TextIO) -> None:
    """Print how many random fields are crossed by each method, and the gaps of those that are not.

    A field is crossed if the exact check passes, goal included.
    """
    count = _QUICK if quick else _FIELDS
    print(
        f"stones: {count} random fields of {SPEC}, to a goal beyond\n"
        "method  crossed  CPU median [s]   95 %  cost median  to search",
        file=stream,
    )
    kept: list[str] = []
    searched = np.nan
    for method in _METHODS:
        times, costs = np.zeros(count), []
        for k in range(count):
            loaded = shipped(SPEC, f"terrain.stones.seed={seed + k}")
            task = build_task(loaded.spec, loaded.robot, loaded.source)
            begin = time.process_time()
            if method == "nlp":
                answer = solve_nlp(task, "walking trot", _SECONDS)
            else:
                answer = search(task, SearchLimits(_SECONDS, qps=loaded.spec.solver.qps))
            times[k] = time.process_time() - begin
            if _holds(task, answer.trajectory):
                costs.append(answer.objective)
            elif method == "search":
                kept.append(f"  field {seed + k}: {widest_gap(task) or answer.word}")
        median = float(np.median(costs)) if costs else np.inf
        searched = median if method == "search" else searched
        print(
            f"{method:<7} {100 * len(costs) / count:6.0f} %  {np.median(times):13.2f}  "
            f"{np.percentile(times, 95):5.2f}  {median:11.1f}  {median / searched:8.2f} x",
            file=stream,
            flush=True,
        )
    if kept:
        print("not crossed by search, with the widest gap of the best way:", file=stream)
        print("\n".join(kept), file=stream)


def _holds(task: WalkTask, found: WalkTrajectory | None) -> bool:
    return found is not None and not failures(check_trajectory(task, found))
