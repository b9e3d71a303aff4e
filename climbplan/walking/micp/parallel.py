"""Parallel branch and bound: several processes take nodes of all cells, lowest bound first.

The supervisor owns the queue of open nodes. A worker gets a node with the incumbent at that time,
and returns its children, its bound and its incumbent. A step on a node is limited by work; the
time limit of the run ends it as well.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor

from climbplan.walking.micp.attitude_partition import AttitudeCell, sort_narrow_first
from climbplan.walking.micp.branch_and_bound import BranchAndBound
from climbplan.walking.micp.branching import WalkSubproblem
from climbplan.walking.micp.node_processing import process_node

_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class _OpenNode:
    """An entry of the queue."""

    cell_index: int
    node: WalkSubproblem
    since: float  # [s] when it entered the queue


@dataclass(frozen=True)
class _NodeResult:
    """The outcome of a step on a node."""

    run: BranchAndBound
    children: tuple[WalkSubproblem, ...]  # none if the node is fathomed, or cannot branch
    seconds: float  # of the process


def bound_in_parallel(run: BranchAndBound, cells: Sequence[AttitudeCell]) -> None:
    """Bound the cells by `limits.processes` processes, best-bound first.

    Args:
        run: The state of the run, which is updated.
        cells: The attitude boxes whose union is bounded.
    """
    num_processes = run.limits.processes
    queue = [
        _OpenNode(
            index,
            replace(run.create_root(cells[index].attitude_box), lower_bound=cells[index].bound),
            run.seconds,
        )
        for index in sort_narrow_first(cells)
    ]
    active, finished = dict[Future[_NodeResult], _OpenNode](), list[_OpenNode]()
    slots, used_seconds = dict[Future[_NodeResult], int](), np.full(num_processes, run.seconds)
    pool = ProcessPoolExecutor(num_processes, env=_ONE_THREAD)
    try:
        while queue or active:
            for slot in sorted(
                set(range(num_processes)) - set(slots.values()), key=used_seconds.__getitem__
            ):
                if not queue or run.needs_restart:
                    break
                entry = queue.pop(int(np.argmin([open_.node.lower_bound for open_ in queue])))
                # The process was idle until the node entered the queue.
                used_seconds[slot] = max(
                    used_seconds[slot], run.seconds if run.uses_wall_clock else entry.since
                )
                seconds_left = run.limits.seconds - float(used_seconds[slot])
                if seconds_left <= 0:
                    finished.append(entry)
                    continue
                worker_run = _create_worker_run(run, entry.node.lower_bound, seconds_left)
                future = pool.submit(_process_in_worker, worker_run, entry.node)
                active[future], slots[future] = entry, slot
            if not active:
                break
            for future in wait(active, return_when=FIRST_COMPLETED).done:
                entry, slot, result = active.pop(future), slots.pop(future), future.result()
                used_seconds[slot] += result.seconds
                _merge_worker_run(run, result.run, float(used_seconds[slot]))
                queue += [
                    _OpenNode(entry.cell_index, child, float(used_seconds[slot]))
                    for child in result.children
                ]
                if not result.children:
                    node = replace(entry.node, lower_bound=result.run.bounds[0])
                    finished.append(replace(entry, node=node))
                _update_bounds(run, [*queue, *active.values(), *finished])
    finally:
        pool.shutdown(wait=True, kill_workers=bool(active))
    run.cell_index = int(np.argmin(run.bounds))


def _create_worker_run(run: BranchAndBound, bound: float, seconds: float) -> BranchAndBound:
    """Return a run on one node, with the incumbent of the supervisor."""
    limits = replace(run.limits, seconds=seconds)
    return replace(run, limits=limits, bounds=[bound], cell_index=0, worker_seconds=0.0, history=[])


_processor_time = 0.0  # [s] of this process at the end of its last node


def _process_in_worker(run: BranchAndBound, node: WalkSubproblem) -> _NodeResult:
    """Process one node in a worker, and measure its time."""
    global _processor_time
    uses_process_clock = run.limits.clock is time.process_time
    run.start_time = _processor_time if uses_process_clock else run.limits.clock()
    children = process_node(run, node)
    _processor_time = time.process_time()
    return _NodeResult(run, tuple(children), run.seconds)


def _merge_worker_run(run: BranchAndBound, worker_run: BranchAndBound, now: float) -> None:
    """Update the incumbent and the tried gaits by those of a worker, at a time [s]."""
    if not run.uses_wall_clock:
        run.worker_seconds += max(now - run.seconds, 0.0)
    if worker_run.objective < run.objective:
        run.incumbent, run.objective = worker_run.incumbent, worker_run.objective
    run.tried_gaits |= worker_run.tried_gaits
    run.message = worker_run.message
    run.needs_restart = run.needs_restart or worker_run.needs_restart


def _update_bounds(run: BranchAndBound, entries: Sequence[_OpenNode]) -> None:
    """Set the bound of each cell to the lowest bound of its nodes, where that is higher."""
    bounds = [
        min(entry.node.lower_bound for entry in entries if entry.cell_index == index)
        for index in range(len(run.bounds))
    ]
    run.bounds = [max(pair) for pair in zip(run.bounds, bounds, strict=True)]
    run.record_progress()
