"""The tables of the comparison as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TextIO

import numpy as np

from benchmarks.limms.published import TABLE
from benchmarks.limms.trial import METHODS, Trial

_LONGEST = 110  # characters of a reason


def write_blocks(trials: Sequence[Trial], out: TextIO) -> None:
    """Sizes and times of the consensus, a published row below each of ours."""
    mine = [trial for trial in trials if trial.method == "admm"]
    if not mine:
        return
    out.write("method admm; published: table 6.3, Gurobi and IPOPT on another machine\n")
    out.write(
        f"{'':<18}{'MIP variables':>16}{'rows':>8}{'NLP variables':>15}{'rows':>8}"
        f"{'MIP [s]':>10}{'NLP [s]':>9}{'refine [s]':>12}{'total [s]':>11}"
        f"{'iterations':>12}{'r_pB [mm]':>11}{'r_pL [mm]':>11}{'r_RL [rad]':>12}\n"
    )
    for trial in mine:
        out.write(_block_row(trial))
        row = TABLE.get(trial.scene)
        if row is not None:
            variables = f"{row.mip_variables} ({row.mip_binaries})"
            out.write(
                f"{'  published':<18}{variables:>16}{row.mip_constraints:>8}"
                f"{row.nlp_variables:>15}{row.nlp_constraints:>8}{60 * row.mip_minutes:>10.0f}"
                f"{60 * row.nlp_minutes:>9.0f}{'':>12}{60 * row.minutes:>11.0f}\n"
            )
    out.write(
        "MIP variables: all (binary, not fixed). NLP: all knots together. MIP: first integers and\n"
        "iterations. Iterations: until mean residuals are 1 cm, 1 cm and 0.1 rad, of all those of\n"
        "the modes that were refined; residuals are means of the best one.\n\n"
    )


def _block_row(trial: Trial) -> str:
    if trial.consensus is None or not trial.sizes:
        return f"{trial.scene:<18}{trial.outcome}: {_short(trial.reason)}\n"
    sizes, times, found = trial.sizes, trial.timings, trial.consensus
    variables = f"{sizes['mip_variables']} ({sizes['mip_binaries']})"
    mip = times["first_integers"] + times["mixed_integer"]
    refine = times["build"] + times["solve"]
    reached = "-" if found.good_after is None else str(found.good_after)
    return (
        f"{trial.scene:<18}{variables:>16}{sizes['mip_constraints']:>8}"
        f"{sizes['nlp_variables']:>15}{sizes['nlp_constraints']:>8}{mip:>10.2f}"
        f"{times['nonlinear']:>9.2f}{refine:>12.2f}{times['total']:>11.2f}"
        f"{f'{reached} of {found.iterations}':>12}{1e3 * found.box:>11.2f}"
        f"{1e3 * found.points:>11.2f}{found.axes:>12.4f}"
        f"{'' if trial.succeeded else '  ' + trial.outcome}\n"
    )


def write_consensus(trials: Sequence[Trial], out: TextIO) -> None:
    """Residuals of the consensus as published and as improved, one below the other."""
    mine = [trial for trial in trials if trial.method.startswith("admm")]
    if not mine:
        return
    out.write(
        f"{'primal residuals':<18}{'':<16}{'r_pB [mm]':>16}{'r_pL [mm]':>16}{'r_RL [rad]':>16}"
        f"{'iterations':>12}{'CPU [s]':>9}   result\n"
    )
    for trial in mine:
        cells = f"{'-':>16}" * 3 + f"{'-':>12}"
        if (found := trial.consensus) is not None:
            cells = (
                f"{f'{1e3 * found.box:.1f} ({1e3 * found.box_most:.0f})':>16}"
                f"{f'{1e3 * found.points:.1f} ({1e3 * found.points_most:.0f})':>16}"
                f"{f'{found.axes:.3f} ({found.axes_most:.2f})':>16}"
                f"{f'{found.good_after or chr(45)} of {found.iterations}':>12}"
            )
        result = trial.sequence if trial.succeeded else trial.outcome
        spent = f"{trial.processor_seconds:>9.1f}"
        out.write(f"{trial.scene:<18}{trial.method:<16}{cells}{spent}   {result}\n")
    out.write(
        "Means (largest) of the best iterate, of the modes that were refined or, without a plan,\n"
        "agreed on best. Iterations: until means are 1 cm, 1 cm and 0.1 rad. admm-published: one\n"
        "second an interval, as many as published, reach in the nonlinear block alone, integers\n"
        "free in every iteration.\n\n"
    )


def write_beside(trials: Sequence[Trial], out: TextIO) -> None:
    """All methods on the same scenes, processor time and its ratio."""
    scenes = list(dict.fromkeys(trial.scene for trial in trials))
    if not scenes:
        return
    out.write(f"{'processor time [s]':<20}" + "".join(f"{name:>16}" for name in METHODS))
    out.write(f"{'admm / modes':>14}   modes found\n")
    for scene in scenes:
        by = {trial.method: trial for trial in trials if trial.scene == scene}
        cells = ""
        for method in METHODS:
            own = by.get(method)
            cells += f"{'' if own is None else f'{own.processor_seconds:.1f}':>16}"
        ratio = ""
        if all(method in by and by[method].succeeded for method in ("modes", "admm")):
            ratio = f"{by['admm'].processor_seconds / by['modes'].processor_seconds:.1f}"
        names = [t.sequence if t.succeeded else t.outcome for t in by.values()]
        out.write(f"{scene:<20}{cells}{ratio:>14}   {' | '.join(dict.fromkeys(names))}\n")
    for trial in trials:
        if not trial.succeeded:
            out.write(f"  {trial.scene}, {trial.method}: {_short(trial.reason)}\n")
    out.write("\n")


def write_random(kind: str, trials: Sequence[Trial], out: TextIO) -> None:
    """Success of each method on random scenes, and why the others failed."""
    out.write(
        f"{'random ' + kind:<20}{'verified':>12}{'median [s]':>12}{'longest [s]':>13}"
        f"{'iterations':>12}\n"
    )
    for method in dict.fromkeys(trial.method for trial in trials):
        own = [trial for trial in trials if trial.method == method]
        times = [trial.processor_seconds for trial in own]
        done = sum(trial.succeeded for trial in own)
        steps = [
            trial.consensus.good_after
            for trial in own
            if trial.consensus is not None and trial.consensus.good_after is not None
        ]
        median = f"{np.median(steps):g}" if steps else ""
        out.write(
            f"{method:<20}{f'{done} of {len(own)}':>12}{np.median(times):>12.1f}"
            f"{max(times):>13.1f}{median:>12}\n"
        )
        for (outcome, reason), number in Counter(
            (trial.outcome, _short(trial.reason)) for trial in own if not trial.succeeded
        ).most_common():
            names = [t.scene for t in own if (t.outcome, _short(t.reason)) == (outcome, reason)]
            out.write(f"  {number} {outcome} ({names[0]}): {reason}\n")
    out.write("\n")


def _short(reason: str) -> str:
    text = " ".join(reason.split())
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
