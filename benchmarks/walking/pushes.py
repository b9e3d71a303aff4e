"""Pushes in one closed loop with all that comes between controller and robot, beside what is asked.

Estimated state, 20 ms from measurement to command, plans at the push: `recovery.py` walks them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TextIO

import numpy as np

from benchmarks.walking.online_options import OnlineInputs, OnlineOptions, in_words
from benchmarks.walking.recovery import recovery_table
from climbplan.arrays import Array
from climbplan.walking.online.estimation import SensorQuality

DELAY = 0.02  # [s]
ASKED = (  # push [m/s], share of walks that recover
    ((-1.0, 0.0, 0.0), 0.99),
    ((-1.5, 0.0, 0.0), 0.99),
    ((-2.8, 0.0, 0.0), 0.95),
    ((0.0, 0.5, 0.0), 0.99),
    ((0.0, 1.0, 0.0), 0.90),
)
MEDIAN, MOST = 1.5, 5.0  # [ms] of ticks, median and 99 %


def push_table(
    inputs: OnlineInputs,
    options: OnlineOptions,
    stream: TextIO,
    report: Callable[[str, float], None],
) -> list[dict[str, Any]]:
    """Print shares of recovered walks beside what is asked, and what verification would refuse.

    Pushes, delay and state are these, whatever the spec says; all else is the spec's. What fell,
    or whose toes were too far out of their boxes, would end with exit code 5.
    """
    pushes = tuple(np.array(push, float) for push, _ in ASKED)
    closed = _closed_loop(inputs, pushes)
    rows = recovery_table(closed, options, stream, report)
    asked = {in_words(push): share for push, (_, share) in zip(pushes, ASKED, strict=True)}
    print(
        "push               walks   asked  recovered   exit 5   ticks: median, 99 % (asked "
        f"{MEDIAN:g}, {MOST:g} ms)",
        file=stream,
    )
    for row in rows:
        share = row["recovered"] / row["trials"]
        row["asked"] = asked[row["push"]]
        print(
            f"{row['push']:<18} {row['walks']:5d} {100 * row['asked']:5.0f} % {100 * share:8.1f} % "
            f"{100 * row['refused']:6.1f} %   {row['median_ms']:.2f}, {row['most99_ms']:.2f} ms",
            file=stream,
        )
    return rows


def _closed_loop(inputs: OnlineInputs, pushes: tuple[Array, ...]) -> OnlineInputs:
    spec, world = inputs.spec, inputs.world
    quality = SensorQuality(**spec.loop.sensors.model_dump())
    loop = spec.loop.model_copy(update={"delay": DELAY, "estimation": "ekf"})
    delay = round(DELAY / inputs.task.sample)
    return replace(
        inputs,
        spec=spec.model_copy(update={"loop": loop}),
        pushes=pushes,
        world=replace(world, estimation=quality, delay_samples=delay, replan_at_push=True),
    )
