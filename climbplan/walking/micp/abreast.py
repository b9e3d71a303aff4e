"""Tubes by several processes, in parts: of those that wait the one with the lowest bound is next.

Parts share nothing but what was found before they began. What a process does with one before it
hands back what is left is bounded by work, not by the clock.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor

from climbplan.walking.micp.bounding import Bounding
from climbplan.walking.micp.covering import Leaf, narrow_first
from climbplan.walking.micp.parts import Part
from climbplan.walking.micp.steps import step

_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class _Asked:
    """What a process is asked for."""

    at: int  # tube
    part: Part
    since: float  # [s] when it could begin


@dataclass(frozen=True)
class _Found:
    """What it found."""

    run: Bounding
    parts: tuple[Part, ...]  # of what is left: none if it is proved, or cannot be parted
    seconds: float  # of the process


def cover_abreast(run: Bounding, leaves: Sequence[Leaf]) -> None:
    """Bound tubes and parts of them by `limits.processes` processes at the same time."""
    count = run.limits.processes
    waiting = [
        _Asked(at, replace(run.whole(leaves[at].tube), bound=leaves[at].bound), run.seconds)
        for at in narrow_first(leaves)
    ]
    open_, done = dict[Future[_Found], _Asked](), list[_Asked]()
    slots, spent = dict[Future[_Found], int](), np.full(count, run.seconds)
    pool = ProcessPoolExecutor(count, env=_ONE_THREAD)
    try:
        while waiting or open_:
            for slot in sorted(set(range(count)) - set(slots.values()), key=spent.__getitem__):
                if not waiting or run.again:
                    break
                asked = waiting.pop(int(np.argmin([one.part.bound for one in waiting])))
                # A process that had nothing to do was idle until there was this.
                spent[slot] = max(spent[slot], run.seconds if run.by_wall else asked.since)
                left = run.limits.seconds - float(spent[slot])
                if left <= 0:
                    done.append(asked)
                    continue
                future = pool.submit(_worked, _begun(run, asked.part.bound, left), asked.part)
                open_[future], slots[future] = asked, slot
            if not open_:
                break
            for future in wait(open_, return_when=FIRST_COMPLETED).done:
                asked, slot, found = open_.pop(future), slots.pop(future), future.result()
                spent[slot] += found.seconds
                _take(run, found.run, float(spent[slot]))
                waiting += [_Asked(asked.at, one, float(spent[slot])) for one in found.parts]
                if not found.parts:
                    part = replace(asked.part, bound=found.run.bounds[0])
                    done.append(replace(asked, part=part))
                _raise(run, [*waiting, *open_.values(), *done])
    finally:
        pool.shutdown(wait=True, kill_workers=bool(open_))
    run.at = int(np.argmin(run.bounds))


def _begun(run: Bounding, bound: float, seconds: float) -> Bounding:
    """A run of one part, from what is known by now."""
    limits = replace(run.limits, seconds=seconds)
    return replace(run, limits=limits, bounds=[bound], at=0, elsewhere=0.0, history=[])


_used = 0.0  # of this process's processor time, by what it was asked before


def _worked(run: Bounding, part: Part) -> _Found:
    """One step on a part."""
    global _used
    run.begin = _used if run.limits.clock is time.process_time else run.limits.clock()
    parts = step(run, part)
    _used = time.process_time()
    return _Found(run, tuple(parts), run.seconds)


def _take(run: Bounding, other: Bounding, now: float) -> None:
    """What another process found, of so many seconds [s]."""
    if not run.by_wall:
        run.elsewhere += max(now - run.seconds, 0.0)
    if other.objective < run.objective:
        run.best, run.objective = other.best, other.objective
    run.seen |= other.seen
    run.word, run.again = other.word, run.again or other.again


def _raise(run: Bounding, parts: Sequence[_Asked]) -> None:
    """The bound of a tube is the least of its parts'."""
    bounds = [min(one.part.bound for one in parts if one.at == at) for at in range(len(run.bounds))]
    run.bounds = [max(pair) for pair in zip(run.bounds, bounds, strict=True)]
    run.note()
