"""The mixed-integer relaxation on the shipped tasks: bounds beside what is asked, and their tubes.

Bounds are of motions within a union of tubes of attitudes, which hold what the search finds from
several seeds, with room either way. Beside them: the gap that is left of the cheapest motion's own
gait, which says how much of the other is for contacts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from typing import TextIO

import numpy as np

from benchmarks.walking.given_gait import bound_of_gait
from benchmarks.walking.shipped_tasks import FORMS, TASKS, shipped
from benchmarks.walking.workers import in_order
from climbplan.walking.micp.limits import MicpLimits, read_limits
from climbplan.walking.micp.solver import solve_micp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.problem.problem import build_task
from climbplan.walking.task.task import ANGLES, SPIN, WalkTask

_SECONDS, _QUICK = 180.0, 8.0  # of each process's processor time
_PROCESSES = 2  # that share a bound's tubes and parts of them
_SEEDS, _QUICK_SEEDS = 10, 2
_LONGEST = 600.0  # of a search, by the wall's clock: its QPs end it
_ASKED = {"mpc_forward": 5, "mpc_disturbance": 10, "mpc_turn": 5, "mpc_stairs": 25}  # [%]
_ROOM = {"angles_deg": (1.0, 2.0, 1.0), "angular_velocity": (0.25, 0.5, 0.25)}


def bound_table(seed: int, quick: bool, jobs: int, stream: TextIO) -> None:
    """Print the lower bound about what several searches find, and how far they are apart."""
    seconds, seeds = (_QUICK, _QUICK_SEEDS) if quick else (_SECONDS, _SEEDS)
    print(
        f"branch and bound: up to {seconds:.0f} s of processor time of each of {_PROCESSES} "
        "processes, published form; bounds are of\nmotions in tubes that hold "
        f"what {seeds} seeds of search find, with "
        f"{_listed(_ROOM['angles_deg'])} deg and "
        f"{_listed(_ROOM['angular_velocity'])} rad/s of room\n"
        "task                cost   bound    gap  (asked)  CPU [s]  tubes  of its gait: gap, "
        "CPU [s]  motions apart at most",
        file=stream,
        flush=True,
    )
    names = TASKS[:1] if quick else TASKS
    # Bounds have processes of their own: no row is bounded beside another one.
    given = list(in_order(partial(_known, seed, quick), names, jobs))
    for name, known in zip(names, given, strict=True):
        print(_row(known, seconds, name), file=stream, flush=True)


@dataclass(frozen=True)
class _Known:
    """What is known of a task before its bound: motions, and the gap that their own gait leaves."""

    task: WalkTask
    limits: MicpLimits
    found: list[WalkAnswer]
    own: float  # [%]
    seconds: float  # of processor time for the latter


def _known(seed: int, quick: bool, name: str) -> _Known:
    """Search, and bound the gait of what is cheapest."""
    seconds, seeds = (_QUICK, _QUICK_SEEDS) if quick else (_SECONDS, _SEEDS)
    loaded = shipped(name, *FORMS["published"])  # `spatial-branch-and-bound` bounds no other
    task = build_task(loaded.spec, loaded.robot, loaded.source)
    qps = loaded.spec.solver.max_qp_solves
    found = [search(task, SearchLimits(_LONGEST, seed=seed + k, qps=qps)) for k in range(seeds)]
    tube = loaded.spec.solver.attitude_box.model_copy(update=_ROOM)
    limits = read_limits(loaded.spec.solver.model_copy(update={"attitude_box": tube}))
    limits = replace(limits, clock=time.process_time)
    asked = replace(limits, seconds=seconds, gap=_ASKED[name] / 100)
    begin = time.process_time()
    own = 100.0 * (1.0 - bound_of_gait(task, asked, found) / min(a.objective for a in found))
    return _Known(task, limits, found, own, time.process_time() - begin)


def _row(known: _Known, seconds: float, name: str) -> str:
    """The line of a task."""
    limits = replace(known.limits, seconds=seconds, processes=_PROCESSES, gap=_ASKED[name] / 100)
    proved = solve_micp(known.task, limits, known.found[0], known.found[1:])
    bound = proved.bound or 0.0
    gap = 100.0 * (1.0 - bound / proved.objective)
    return (
        f"{name:<16} {proved.objective:7.2f} {bound:7.2f} {gap:4.1f} %  ({_ASKED[name]:2d} %)  "
        f"{proved.seconds:7.0f}  {proved.tubes:5d}  {known.own:14.1f} %  {known.seconds:7.0f}  "
        f"{_apart(known.found)}"
    )


def _apart(found: list[WalkAnswer]) -> str:
    """The largest differences of angles and angular velocities at a knot."""
    states = [answer.trajectory.state for answer in found if answer.trajectory is not None]
    apart = np.ptp(np.stack(states)[:, :-1], axis=0).max(axis=0)
    return f"{_listed(np.rad2deg(apart[ANGLES]))} deg, {_listed(apart[SPIN])} rad/s"


def _listed(values: object) -> str:
    return "/".join(f"{value:.3g}" for value in np.round(np.asarray(values, float), 2))
