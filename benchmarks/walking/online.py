"""Online: ticks of the pinned form beside the published one, in the same situations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TextIO

import numpy as np

from benchmarks.walking.online_options import OnlineInputs
from benchmarks.walking.recovery_study import WITHIN
from climbplan.walking.online.candidate_selection import SAFE_STANCE, Command
from climbplan.walking.online.closed_loop import LoopScenario, Push, freeze_garbage, simulate_loop
from climbplan.walking.online.controller import OnlineController, OnlineSettings
from climbplan.walking.online.library import SectionLibrary
from climbplan.walking.online.tick_input import TickInput
from climbplan.walking.published.program import TOLERANCE
from climbplan.walking.task.task import WalkTask

_FORMS = (("regions of the neighbour", 0.0), ("and one on either side", 1.0))
_EVERY = 4  # ticks of which the published form is given one
_BETWEEN = 1.3  # [s] from push to push


class Watching(OnlineController):
    """A controller that keeps what it was told."""

    def __init__(self, task: WalkTask, library: SectionLibrary, settings: OnlineSettings) -> None:
        super().__init__(task, library, settings)
        self.situations: list[TickInput] = []

    def tick(self, situation: TickInput) -> Command:
        """As of every controller."""
        self.situations.append(situation)
        return super().tick(situation)


def tick_tables(
    inputs: OnlineInputs, seed: int, quick: bool, stream: TextIO
) -> list[dict[str, Any]]:
    """Print times of both forms with each library, 10 s of walking with a push every 1.3 s."""
    rows: list[dict[str, Any]] = []
    for library in inputs.libraries:
        with freeze_garbage():
            rows += _ticks(inputs, library, seed, 3.0 if quick else 10.0, stream)
    return rows


def _ticks(
    inputs: OnlineInputs, library: SectionLibrary, seed: int, duration: float, stream: TextIO
) -> list[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    pushes = [
        Push(at + rng.uniform(0, WITHIN), inputs.pushes[k % min(3, len(inputs.pushes))])
        for k, at in enumerate(np.arange(1.0, duration - 0.5, _BETWEEN))
    ]
    controller = Watching(inputs.task, library, OnlineSettings())
    loop = simulate_loop(controller, inputs.task, duration, LoopScenario(pushes=pushes), seed=seed)
    end = "to its end" if loop.fall_time is None else f"fell after {loop.fall_time:.1f} s"
    print(
        f"ticks of {duration:g} s with {len(pushes)} pushes ({end}), library of {library.walks} "
        f"walks; an answer holds if its rollout in continuous time does\n"
        "form                                 solver         answers   hold  median [ms]    "
        "99 %   to pinned",
        file=stream,
    )
    rows = [_row("pinned", "DAQP", library, loop.commands, None, stream)]
    for title, beside in _FORMS:
        settings = OnlineSettings(form="published", neighbour_region_fraction=beside)
        published = OnlineController(inputs.task, library, settings)
        commands = [published.tick(told) for told in controller.situations[::_EVERY]]
        name, median = f"published, {title}", rows[0]["median_ms"]
        rows.append(_row(name, f"OSQP {TOLERANCE:g}", library, commands, median, stream))
    return rows


def _row(
    title: str,
    solver: str,
    library: SectionLibrary,
    commands: Sequence[Command],
    against: float | None,
    stream: TextIO,
) -> dict[str, Any]:
    """Print one form's line and give its figures; against: median of the pinned form [ms]."""
    times = 1e3 * np.array([command.tick_time for command in commands])
    median, most = np.percentile(times, [50, 99])
    answers = 100 * np.mean([command.source != SAFE_STANCE for command in commands])
    hold = 100 * np.mean([command.is_feasible for command in commands])
    ratio = median / (median if against is None else against)
    print(
        f"{title:<36} {solver:<12} {answers:7.0f} % {hold:4.0f} %  "
        f"{median:11.2f} {most:7.2f} {ratio:9.1f} x",
        file=stream,
        flush=True,
    )
    return {
        "form": title,
        "solver": solver,
        "walks": library.walks,
        "ticks": len(times),
        "answers_percent": float(answers),
        "hold_percent": float(hold),
        "median_ms": float(median),
        "most99_ms": float(most),
        "to_pinned": float(ratio),
    }
