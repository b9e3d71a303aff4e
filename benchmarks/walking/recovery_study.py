"""Recovery from pushes over many trials: how often a closed loop comes back, and how it fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from joblib import Parallel, delayed

from climbplan.arrays import Array
from climbplan.walking.online.candidate_selection import SAFE_STANCE
from climbplan.walking.online.closed_loop import (
    LoopResult,
    LoopScenario,
    Push,
    compute_mean_velocity,
    freeze_garbage,
    has_recovered,
    simulate_loop,
)
from climbplan.walking.online.controller import OnlineController, OnlineSettings
from climbplan.walking.online.library import SectionLibrary
from climbplan.walking.online.section_ranking import Ranking
from climbplan.walking.task.task import VELOCITY, WalkTask

FIRST, WITHIN = 1.0, 0.16  # [s] when pushes come, at random within two knots
AFTER = 1.4  # [s] from the push on
MIRRORED = np.array([1.0, -1.0, 1.0])  # every other push


@dataclass(frozen=True)
class Study:
    """Walks at the reference, each pushed once at a random time; every other one mirrored.

    Trial k is the same whatever the number of trials and workers: its randomness is [seed, k].
    """

    task: WalkTask
    library: SectionLibrary
    push: Array  # (3,) change of velocity [m/s]
    count: int
    seed: int = 0
    settings: OnlineSettings = field(default_factory=OnlineSettings)
    world: LoopScenario = field(default_factory=LoopScenario)  # its pushes are the study's
    ranking: Ranking | None = None  # nearest neighbours if None


@dataclass(frozen=True)
class Trial:
    """How one walk ended."""

    recovered: bool
    fell: float | None  # [s] after the push; before it below zero
    off: float  # [m/s] of the mean velocity over the last 0.48 s
    least_speed: float  # [m/s] lowest forward velocity after the push
    unanswered: int  # ticks after the push for which no gait held
    safe: int  # and of these those that could only brace: safe stance
    overreach: float  # [m]
    tick_time: Array  # (ticks,) [s] of processor time
    fault: str  # the commonest warning after the push, without its numbers; "" if none

    @property
    def ending(self) -> str:
        """`recovered`, `fell`, or `off the reference`: up, but not at its velocity."""
        if self.recovered:
            return "recovered"
        return "off the reference" if self.fell is None else "fell"


def run_study(
    study: Study, jobs: int = 1, report: Callable[[float], None] | None = None
) -> tuple[Trial, ...]:
    """All trials, by so many worker processes."""
    found: list[Trial] = []
    for part in _parts(study, jobs):
        found += part
        if report is not None:
            report(len(found) / study.count)
    return tuple(found)


def one_trial(study: Study, k: int) -> Trial:
    """Trial k."""
    rng = np.random.default_rng([study.seed, k])
    at = FIRST + float(rng.uniform(0, WITHIN))
    push = Push(at, study.push * (MIRRORED if k % 2 else 1.0))
    controller = OnlineController(study.task, study.library, study.settings, study.ranking)
    world = replace(study.world, pushes=[push])
    loop = simulate_loop(controller, study.task, FIRST + AFTER, world, seed=study.seed + k)
    return judged(loop, study.task, at)


def judged(loop: LoopResult, task: WalkTask, at: float) -> Trial:
    """How a walk that was pushed at a time ended."""
    after = [
        command
        for sample, command in zip(loop.tick_samples, loop.commands, strict=True)
        if sample * task.sample >= at - 0.5 * task.dt
    ]
    sample = round(at / task.sample)
    speed = loop.trajectory.state[sample:, VELOCITY]
    words = [command.warning for command in after if command.warning]
    off = compute_mean_velocity(loop.trajectory, task.sample) - task.reference.velocity[-1]
    return Trial(
        recovered=has_recovered(loop, task),
        fell=None if loop.fall_time is None else loop.fall_time - at,
        off=float(np.linalg.norm(off[:2])),
        least_speed=float(speed[:, 0].min()) if len(speed) else float("nan"),
        unanswered=sum(not command.is_feasible for command in after),
        safe=sum(command.source == SAFE_STANCE for command in after),
        overreach=loop.reach_violation,
        tick_time=np.array([command.tick_time for command in loop.commands]),
        fault=max(sorted(set(words)), key=words.count) if words else "",
    )


def _parts(study: Study, jobs: int) -> Iterator[list[Trial]]:
    """Trials in order, a part at a time; workers take a part with the study at once."""
    if jobs == 1:
        with freeze_garbage():
            for k in range(study.count):
                yield [one_trial(study, k)]
        return
    size = max(1, -(-study.count // (4 * jobs)))
    ranges = [range(k, min(k + size, study.count)) for k in range(0, study.count, size)]
    # Arrays are passed as they are: mapped ones are read-only, which would be compiled anew.
    work = Parallel(n_jobs=jobs, return_as="generator", max_nbytes=None)
    yield from work(delayed(_some)(study, part) for part in ranges)


def _some(study: Study, part: range) -> list[Trial]:
    with freeze_garbage():
        return [one_trial(study, k) for k in part]
