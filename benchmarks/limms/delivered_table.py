"""Shipped scenes planned, verified and simulated, with the time of all three together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TextIO

from benchmarks.limms.shipped import SEVEN
from benchmarks.limms.trial import Trial

_LONGEST = 300  # characters of a reason


def write_delivered(title: str, trials: Sequence[Trial], out: TextIO) -> None:
    """A row each, sums of those of the seven scenes, and why others have no plan."""
    if not trials:
        return
    out.write(
        f"{title:<18}{'module':<20}{'checks':>12}{'plan [s]':>10}{'verify':>8}{'simulate':>10}"
        f"{'box off, at the end [mm]':>26}{'latches [mm]':>14}{'force (planned) [N]':>22}"
        f"{'torque (planned) [N m]':>24}   simulated\n"
    )
    for trial in trials:
        out.write(_row(trial))
    own = [trial for trial in trials if trial.scene in SEVEN]
    for name, some in (("the seven scenes", own), ("all", trials)):
        if some and (some is own or len(own) < len(trials)):
            out.write(_together(name, some))
    for trial in trials:
        if not trial.succeeded:
            text = " ".join(trial.reason.split())
            text = text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
            out.write(f"  {trial.scene}, {trial.outcome}: {text}\n")
    out.write(
        "Processor time. Off: from the planned way, at most. Latches: off where they close. Force\n"
        "and torque: the most of any contact and joint, simulated and as planned.\n\n"
    )


def _row(trial: Trial) -> str:
    checks = f"{trial.checks} pass" if trial.succeeded else trial.outcome
    row = f"{trial.scene:<18}{trial.hardware:<20}{checks:>12}{trial.processor_seconds:>10.1f}"
    found = trial.replay
    if found is None:
        return f"{row}{trial.verifying_seconds:>8.1f}\n"
    return (
        f"{row}{trial.verifying_seconds:>8.1f}{found.processor_seconds:>10.1f}"
        f"{f'{1e3 * found.off:.1f}, {1e3 * found.off_at_end:.1f}':>26}{1e3 * found.misses:>14.1f}"
        f"{f'{found.force:.1f} ({found.force_planned:.1f})':>22}"
        f"{f'{found.torque:.1f} ({found.torque_planned:.1f})':>24}   {found.outcome}\n"
    )


def _together(name: str, trials: Sequence[Trial]) -> str:
    verified = sum(trial.succeeded for trial in trials)
    spent = sum(trial.processor_seconds + trial.verifying_seconds for trial in trials)
    text = f"{name}: {verified} of {len(trials)} verified"
    replays = [trial.replay for trial in trials if trial.replay is not None]
    if not replays:
        return (
            f"{text}, none simulated, as MuJoCo is not installed;\n"
            f"processor time {spent:.0f} s of planning and verification\n"
            if verified
            else f"{text}\n"
        )
    held = sum(replay.holds for replay in replays)
    played = sum(replay.processor_seconds for replay in replays)
    return (
        f"{text}, {held} simulated to the goal without a broken latch;\n"
        f"processor time {spent:.0f} s of planning and verification, {played:.0f} s of simulation\n"
    )
