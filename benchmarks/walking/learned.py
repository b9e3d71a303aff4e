"""Learned strategies on fresh tasks: one library of walks, on ground that it has not seen.

Each task is planned once, 400 ms ahead, by a tick of the controller without a plan before: gaits of
the library in the order of the strategy, then those by name. Its cost is set against what
`gait-search` finds of the same task.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TextIO

import numpy as np

from benchmarks.walking.online_options import OnlineInputs
from benchmarks.walking.shipped_tasks import shipped_task
from climbplan.walking.dynamics.cost import compute_objective
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.online.candidate_selection import Command
from climbplan.walking.online.controller import OnlineController, OnlineSettings, build_horizon_task
from climbplan.walking.online.footholds import compute_reference_clearance, follow_terrain
from climbplan.walking.online.library import SectionLibrary
from climbplan.walking.online.section_ranking import Ranking, StrategyName, train_section_ranking
from climbplan.walking.online.tick_input import TickInput
from climbplan.walking.problem.random_tasks import StartRanges, sample_start
from climbplan.walking.task.task import WalkTask

STRATEGIES: tuple[StrategyName, ...] = ("knn", "forest", "boosting", "network", "reduce")
_TASKS, _QUICK = 20, 2  # of each kind
_QPS, _QUICK_QPS = 150, 30
_LONGEST = 60.0  # [s] of a search, which its QPs end before
_RANGES = StartRanges(lateral=0.5, tilt=0.1, angular_velocity=0.6, toes=0.04)
_HEAVIER = 0.2  # share of the mass either way

Draw = Callable[[WalkTask, int, np.random.Generator], WalkTask]


@dataclass(frozen=True)
class Fresh:
    """A task, the knots of it that a tick plans, and what `gait-search` pays for these.

    The cost is infinite if it finds nothing.
    """

    task: WalkTask
    ahead: WalkTask
    cost: float


def strategy_table(
    inputs: OnlineInputs, seed: int, quick: bool, stream: TextIO
) -> list[dict[str, Any]]:
    """Print success, cost against `gait-search` and time of a tick, by strategy and task."""
    count, library = _QUICK if quick else _TASKS, inputs.libraries[-1]
    qps = _QUICK_QPS if quick else _QPS
    print(
        f"strategies of one library, {library.walks} walks; {count} fresh tasks of each kind, "
        f"400 ms each;\nsearch: {qps} QPs; ticks: processor time\n"
        "tasks              strategy  answered  by search  cost to search: median, 95 %  "
        "of library  tick [ms]   99 %",
        file=stream,
    )
    ranked = {name: train_section_ranking(name, library, seed) for name in STRATEGIES}
    rows: list[dict[str, Any]] = []
    for title, draw in KINDS.items():
        tasks = [
            _searched(draw(inputs.task, k, np.random.default_rng([seed, 1, k])), qps)
            for k in range(count)
        ]
        for name, ranking in ranked.items():
            settings = replace(inputs.settings, height_weight=None)  # costs are the tasks'
            commands = list(_planned(tasks, library, settings, ranking))
            rows.append(_row(title, name, tasks, commands, stream))
    return rows


def _flat(task: WalkTask, number: int, rng: np.random.Generator) -> WalkTask:
    return sample_start(task, _RANGES, rng).task


def _heavier(task: WalkTask, number: int, rng: np.random.Generator) -> WalkTask:
    drawn, more = sample_start(task, _RANGES, rng).task, 1.0 + _HEAVIER * rng.uniform(-1, 1)
    body = replace(drawn.body, mass=more * drawn.body.mass, inertia=more * drawn.body.inertia)
    return replace(drawn, body=body)


def _stairs(task: WalkTask, number: int, rng: np.random.Generator) -> WalkTask:
    return shipped_task("mpc_stairs", *_start(rng, (-0.1, 0.7), (0.4, 1.2)))


def _stones(task: WalkTask, number: int, rng: np.random.Generator) -> WalkTask:
    field = (f"terrain.stones.seed={number}", "task.goal=null")
    return shipped_task("mpc_stones", *field, *_start(rng, (0.1, 0.7), (0.2, 0.8)))


def _start(
    rng: np.random.Generator, x: tuple[float, float], forward: tuple[float, float]
) -> tuple[str, ...]:
    """Somewhere on the way, at some speed, with the online controller's demands."""
    speed = [rng.uniform(*forward), rng.uniform(-0.2, 0.2), 0.0]
    return (
        "solver.method=online",
        f"task.start.position=[{rng.uniform(*x):.4f}, 0]",
        f"task.start.velocity=[{', '.join(f'{value:.4f}' for value in speed)}]",
    )


KINDS: dict[str, Draw] = {
    "flat": _flat,
    "flat, mass +-20 %": _heavier,
    "stairs, 0.8 m/s": _stairs,
    "stones, 0.5 m/s": _stones,
}


def _searched(task: WalkTask, qps: int) -> Fresh:
    ahead = follow_terrain(build_horizon_task(task), compute_reference_clearance(task))
    found = search(ahead, SearchLimits(_LONGEST, qps=qps))
    return Fresh(task, ahead, found.objective if found.trajectory is not None else np.inf)


def _planned(
    tasks: list[Fresh], library: SectionLibrary, settings: OnlineSettings, ranking: Ranking
) -> Iterator[Command]:
    made: OnlineController | None = None
    for fresh in tasks:
        task, start = fresh.task, fresh.task.start
        if made is None or made.task.ground is not task.ground or made.task.body is not task.body:
            made = OnlineController(task, library, settings, ranking)
        made.reset()
        before = start.toes  # nothing moved before
        yield made.tick(TickInput(start.state, start.toes, before, np.ones(len(start.toes), bool)))


def _row(
    title: str, name: str, tasks: list[Fresh], commands: list[Command], stream: TextIO
) -> dict[str, Any]:
    """Print a line and give its figures; costs are of tasks that both answer."""
    held = np.array([command.is_feasible for command in commands])
    found = np.array([np.isfinite(fresh.cost) for fresh in tasks])
    ratio = [
        compute_objective(fresh.ahead, command.trajectory.state, command.trajectory.force)
        / fresh.cost
        for fresh, command in zip(tasks, commands, strict=True)
        if command.is_feasible and np.isfinite(fresh.cost)
    ]
    median, most = np.percentile(ratio, [50, 95]) if ratio else (np.nan, np.nan)
    times = [1e3 * command.tick_time for command in commands]
    middle, longest = np.percentile(times, [50, 99])
    own = np.mean([command.is_feasible and command.source >= 0 for command in commands])
    print(
        f"{title:<18} {name:<9} {100 * held.mean():6.0f} %  {100 * found.mean():7.0f} %  "
        f"{median:22.2f}, {most:4.2f}  {100 * own:8.0f} %  {middle:9.2f} {longest:6.2f}",
        file=stream,
        flush=True,
    )
    return {
        "tasks": title,
        "strategy": name,
        "count": len(tasks),
        "answered": float(held.mean()),
        "searched": float(found.mean()),
        "cost_to_search": float(median) if ratio else None,
        "cost_to_search_95": float(most) if ratio else None,
        "of_library": float(own),
        "median_ms": float(middle),
        "most99_ms": float(longest),
    }
