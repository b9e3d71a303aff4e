"""Recovery from pushes with libraries of several sizes, and what the others ended in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TextIO

import numpy as np

from benchmarks.walking.online_options import OnlineInputs, OnlineOptions, in_words
from benchmarks.walking.recovery_study import Study, Trial, run_study
from climbplan.walking.check.checker import LOOP_LIMITS
from climbplan.walking.online.section_ranking import train_section_ranking

_HEAD = (
    "push               walks recovered   fell  off [1]  no answer [2]  overreach [mm]  "
    "broken [3]  median [ms]   99 %\n"
)
_NOTES = (
    "[1] up, but not at the reference; [2] ticks a walk after the push for which no gait held; "
    "medians\nof the largest overreach of standing toes; [3] walks with more than verification "
    "passes,\nrecovered or not; ticks: processor time\n"
)


def recovery_table(
    inputs: OnlineInputs,
    options: OnlineOptions,
    stream: TextIO,
    report: Callable[[str, float], None],
) -> list[dict[str, Any]]:
    """Print shares of recovered walks for each library and push, and why others failed."""
    loop, rows, told = inputs.spec.loop, [], Counter[str]()
    state = "estimated state" if loop.estimation == "ekf" else "true state"
    legs = f"{loop.leg_model} legs" + (f", delay {1e3 * loop.delay:g} ms" if loop.delay else "")
    if loop.delay and not loop.compensate_delay:
        legs += " (not compensated)"
    chosen = inputs.spec.library.strategy
    print(f"recovery, {options.trials} trials each: {state}, {legs}, {chosen}", file=stream)
    stream.write(_HEAD)
    for library in inputs.libraries:
        ranking = train_section_ranking(chosen, library, options.seed)
        for push in inputs.pushes:
            words = in_words(push)
            study = Study(
                inputs.task, library, push, options.trials, options.seed,
                inputs.settings, inputs.world, ranking,
            )  # fmt: skip
            stage = f"{words}, {library.walks} walks"
            found = run_study(study, options.jobs, partial(report, stage))
            rows.append(_row(words, library.walks, found, stream))
            told.update(f"{words}: {fault}" for fault in _faults(found))
    stream.write(_NOTES)
    for fault, count in told.most_common():
        print(f"  {count:3d} not recovered, {fault}", file=stream)
    return rows


def _faults(found: Sequence[Trial]) -> list[str]:
    """How each walk failed that did, and what its ticks said."""
    return [
        trial.ending + (f" ({trial.fault})" if trial.fault else "")
        for trial in found
        if not trial.recovered
    ]


def _row(words: str, walks: int, found: Sequence[Trial], stream: TextIO) -> dict[str, Any]:
    count = len(found)
    endings = Counter(trial.ending for trial in found)
    median, most = 1e3 * np.percentile(np.concatenate([t.tick_time for t in found]), [50, 99])
    unanswered = float(np.mean([trial.unanswered for trial in found]))
    overreach = 1e3 * float(np.median([trial.overreach for trial in found]))
    limit = LOOP_LIMITS["workspace.standing"].value
    broken = float(np.mean([trial.overreach > limit for trial in found]))
    refused = np.mean([trial.overreach > limit or trial.fell is not None for trial in found])
    back, fell = endings["recovered"] / count, endings["fell"] / count
    off = endings["off the reference"] / count
    print(
        f"{words:<18} {walks:5d} {100 * back:7.0f} % {100 * fell:4.0f} % {100 * off:6.0f} %  "
        f"{unanswered:13.1f} {overreach:15.0f} {100 * broken:9.0f} % {median:12.2f} {most:6.2f}",
        file=stream,
        flush=True,
    )
    return {
        "push": words,
        "walks": walks,
        "trials": count,
        "recovered": endings["recovered"],
        "fell": endings["fell"],
        "off_the_reference": endings["off the reference"],
        "safe_stances": float(np.mean([trial.safe for trial in found])),
        "unanswered": unanswered,
        "overreach_mm": overreach,
        "broken": broken,
        "refused": float(refused),
        "median_ms": float(median),
        "most99_ms": float(most),
        "failed": [k for k, trial in enumerate(found) if not trial.recovered],
    }
