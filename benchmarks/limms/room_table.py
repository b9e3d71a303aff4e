"""Random rooms as a table: what was found and verified, what was proved, what is left open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TextIO

import numpy as np

from benchmarks.limms.trial import Trial

_LONGEST = 400  # characters of a reason
COLUMNS = {  # outcomes of trials
    "verified": ("verified",),
    "proved impossible": ("infeasible",),
    "not found": ("not proved", "limit"),
    "not verified": ("not verified",),
}


def counts(trials: Sequence[Trial]) -> dict[str, int]:
    """How many trials ended how."""
    return {
        column: sum(trial.outcome in outcomes for trial in trials)
        for column, outcomes in COLUMNS.items()
    }


def write_rooms(kind: str, trials: Sequence[Trial], out: TextIO) -> None:
    """Counts by where the goal is and how many modules there are, then every refusal."""
    if not trials:
        return
    out.write(
        f"{f'random {kind}':<20}{'rooms':>7}" + "".join(f"{name:>19}" for name in COLUMNS) + "\n"
    )
    for title in dict.fromkeys(trial.title for trial in trials):
        _row(title, [trial for trial in trials if trial.title == title], out)
    for modules in sorted({trial.modules for trial in trials}):
        own = [trial for trial in trials if trial.modules == modules]
        _row(f"{modules} module" + "s" * (modules > 1), own, out)
    _row("all", trials, out)
    found = counts(trials)
    possible = len(trials) - found["proved impossible"]
    times = [trial.processor_seconds for trial in trials]
    out.write(
        f"found and verified: {found['verified'] / len(trials):.0%} of all, "
        f"{found['verified'] / max(possible, 1):.0%} of those that are not proved impossible; "
        f"processor time {np.median(times):.1f} s (median), {max(times):.1f} s (longest), "
        f"{sum(times):.0f} s (all)\n"
    )
    for trial in trials:
        if not trial.succeeded:
            column = next(name for name, some in COLUMNS.items() if trial.outcome in some)
            text = " ".join(trial.reason.split())
            text = text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
            out.write(f"  {trial.scene} ({trial.title}), {column}: {text}\n")
    out.write("\n")


def _row(name: str, trials: Sequence[Trial], out: TextIO) -> None:
    cells = "".join(f"{number:>19}" for number in counts(trials).values())
    out.write(f"{name:<20}{len(trials):>7}{cells}\n")
