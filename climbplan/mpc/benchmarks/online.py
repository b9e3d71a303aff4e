"""Online: ticks of the pinned form against the published one, and recovery from pushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TextIO

import numpy as np

from climbplan.mpc.benchmarks.shipped_tasks import shipped_task
from climbplan.mpc.closed_loop import LoopWorld, Push, collected_before, recovered, run_loop
from climbplan.mpc.estimation import SensorQuality
from climbplan.mpc.library import Library, build_library
from climbplan.mpc.measurement import Situation
from climbplan.mpc.online import SAFE, Command, OnlineController, OnlineSettings
from climbplan.mpc.published import TOLERANCE
from climbplan.mpc.task import Array, WalkTask

PUSHES = {
    "back by 1.0 m/s": (-1.0, 0.0, 0.0),
    "back by 1.5 m/s": (-1.5, 0.0, 0.0),
    "aside by 0.5 m/s": (0.0, 0.5, 0.0),
}
_FIRST, _WITHIN = 1.0, 0.16  # [s] when pushes come, at random within two knots
_AFTER = 1.4  # [s] from the push on
_FORMS = (("regions of the neighbour", 0.0), ("and one on either side", 1.0))
_EVERY = 4  # ticks of which the published form is given one
_WALKS, _QUICK_WALKS = 110, 6
_TRIALS, _QUICK_TRIALS = 100, 3
_GAITS = 5


@dataclass(frozen=True)
class Trials:
    """Closed loops under one kind of push."""

    count: int
    recovered: int
    fell: int
    overreach: Array  # (count,) [m]
    tick_time: Array  # (ticks,) [s] of processor time


class Watching(OnlineController):
    """A controller that keeps what it was told."""

    def __init__(self, task: WalkTask, library: Library, settings: OnlineSettings) -> None:
        super().__init__(task, library, settings)
        self.situations: list[Situation] = []

    def tick(self, situation: Situation) -> Command:
        """As of every controller."""
        self.situations.append(situation)
        return super().tick(situation)


def online_tables(seed: int, quick: bool, stream: TextIO) -> None:
    """Print ticks of both forms, then recovery with and without state estimation."""
    task = shipped_task("mpc_recovery")
    walks = _QUICK_WALKS if quick else _WALKS
    library = build_library(task, walks, seed, 0 if quick else _GAITS)
    with collected_before():
        _ticks(task, library, seed, quick, stream)
        _recovery(task, library, seed, quick, stream)


def trials(
    task: WalkTask,
    library: Library,
    push: Sequence[float],
    count: int,
    seed: int,
    settings: OnlineSettings | None = None,
    world: LoopWorld | None = None,
) -> Trials:
    """Walks at the reference, pushed at random times; every other one to the other side."""
    settings, world = settings or OnlineSettings(), world or LoopWorld()
    back, fell, out, times = 0, 0, [], []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        jump = np.array(push, float) * [1.0, (-1.0) ** k, 1.0]
        when = _FIRST + rng.uniform(0, _WITHIN)
        controller = OnlineController(task, library, settings)
        pushed = replace(world, pushes=[Push(when, jump)])
        loop = run_loop(controller, task, _FIRST + _AFTER, pushed, seed=seed + k)
        back += recovered(loop, task)
        fell += loop.fell is not None
        out.append(loop.overreach)
        times += [command.tick_time for command in loop.commands]
    return Trials(count, back, fell, np.array(out), np.array(times))


def _ticks(task: WalkTask, library: Library, seed: int, quick: bool, stream: TextIO) -> None:
    """Both forms from the same situations: 10 s of walking with a push every second."""
    rng = np.random.default_rng(seed)
    duration = 3.0 if quick else 10.0
    kinds = list(PUSHES.values())
    pushes = [
        Push(at + rng.uniform(0, _WITHIN), np.array(kinds[k % len(kinds)]))
        for k, at in enumerate(np.arange(1.0, duration - 0.5, 1.3))
    ]
    controller = Watching(task, library, OnlineSettings())
    loop = run_loop(controller, task, duration, LoopWorld(pushes=pushes), seed)
    pinned = [command.tick_time for command in loop.commands]
    end = "to its end" if loop.fell is None else f"fell after {loop.fell:.1f} s"
    print(
        f"ticks of {duration:g} s with {len(pushes)} pushes ({end}), library of {library.walks} "
        f"walks; an answer holds if its rollout in continuous time does\n"
        "form                                 solver         answers   hold  median [ms]    "
        "99 %   to pinned",
        file=stream,
    )
    median = _row("pinned", "DAQP", loop.commands, float(np.median(pinned)), stream)
    for title, beside in _FORMS:
        settings = OnlineSettings(form="published", beside=beside)
        published = OnlineController(task, library, settings)
        chosen = controller.situations[::_EVERY]
        commands = [published.tick(situation) for situation in chosen]
        _row(f"published, {title}", f"OSQP {TOLERANCE:g}", commands, median, stream)


def _row(
    title: str, solver: str, commands: Sequence[Command], against: float, stream: TextIO
) -> float:
    times = np.array([command.tick_time for command in commands])
    median, most = np.percentile(times, [50, 99])
    answers = np.mean([command.winner != SAFE for command in commands])
    hold = np.mean([command.holds for command in commands])
    print(
        f"{title:<36} {solver:<12} {100 * answers:7.0f} % {100 * hold:4.0f} %  "
        f"{1e3 * median:11.2f} {1e3 * most:7.2f} {median / against:9.1f} x",
        file=stream,
        flush=True,
    )
    return float(median)


def _recovery(task: WalkTask, library: Library, seed: int, quick: bool, stream: TextIO) -> None:
    count = _QUICK_TRIALS if quick else _TRIALS
    print(
        f"recovery, {count} trials each\n"
        "push               walks  state      recovered  fell  overreach [mm]  median [ms]   99 %",
        file=stream,
    )
    libraries = [library] if quick else [library.first(12), library]
    for stored in libraries:
        for title, push in PUSHES.items():
            for told, quality in (("true", None), ("estimated", SensorQuality())):
                world = LoopWorld(estimation=quality)
                found = trials(task, stored, push, count, seed, world=world)
                median, most = np.percentile(found.tick_time, [50, 99])
                print(
                    f"{title:<18} {stored.walks:5d}  {told:<9} "
                    f"{100 * found.recovered / count:9.0f} % {found.fell:5d} "
                    f"{1e3 * np.median(found.overreach):15.0f} {1e3 * median:12.2f} "
                    f"{1e3 * most:6.2f}",
                    file=stream,
                    flush=True,
                )
