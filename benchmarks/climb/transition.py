"""`transition`: complementarity from random starts against the search."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TextIO

import numpy as np

from climbplan.climb.check.verification import verify
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.plan.file import write_climb
from climbplan.climb.schema.transition_loading import load_transition_text
from climbplan.climb.transition.homotopy import run_from_start
from climbplan.climb.transition.motion import plan_motion
from climbplan.climb.transition.planner import plan_transition
from climbplan.climb.transition.pose_paths import ContactSequence
from climbplan.climb.transition.scene import build_transition
from climbplan.climb.transition.search import SequenceSearch
from climbplan.climb.transition.sequence_planning import (
    CompleteMotion,
    TransitionResult,
    TransitionRun,
    assemble_plan,
    plan_and_verify_sequence,
)
from climbplan.climb.transition.stance_forces import SearchTables
from climbplan.schema.examples import read_example
from climbplan.schema.source import SourceText

_STARTS, _QUICK = 50, 6


@dataclass(frozen=True)
class _Row:
    rounds: int
    search: float  # [s] all sequences
    sequences: int
    motion: float  # [s] warm, median over sequences
    starts: int
    num_homotopies: float  # homotopies of a start, mean
    verified: int
    homotopy: float  # [s] median of a start
    plan: float  # [s] a whole plan by the search


def run_transition(seed: int, quick: bool, stream: TextIO) -> None:
    """Print one row for each number of rounds on the flat scene."""
    print(
        "rounds  sequences  search [s]  motion, warm [ms]  plan [s] | starts  verified     tries  "
        "homotopy [s]  to plan by search",
        file=stream,
    )
    for rounds in (2, 3):
        row = _measured(rounds, seed, _QUICK if quick else _STARTS)
        print(
            f"{row.rounds:6d}  {row.sequences:9d}  {row.search:10.2f}  {1e3 * row.motion:17.0f}  "
            f"{row.plan:8.2f} | {row.starts:6d}  {100 * row.verified / row.starts:6.0f} %  "
            f"{row.num_homotopies:8.1f}  {row.homotopy:12.2f}  {row.homotopy / row.plan:14.2f} x",
            file=stream,
            flush=True,
        )


def _measured(rounds: int, seed: int, starts: int) -> _Row:
    text = SourceText(
        "transition_flat", "transition_flat", Path.cwd(), read_example("transition_flat")
    )
    loaded = load_transition_text(text, [f"task.rounds={rounds}"])
    scene = build_transition(loaded)
    begin = time.perf_counter()
    search = SequenceSearch(scene)
    sequences = search.list_sequences()
    searched = time.perf_counter() - begin
    plan_motion(search.tables, sequences[0])  # builds the program
    motions = [plan_motion(search.tables, sequence).seconds for sequence in sequences[:10]]
    begin = time.perf_counter()
    plan_transition(loaded)
    planned = time.perf_counter() - begin

    good: list[bool] = []

    def carry(tables: SearchTables, sequence: ContactSequence) -> str:
        run = TransitionRun(loaded, scene, StageClock(lambda stage, fraction: None))
        attempt = plan_and_verify_sequence(run, tables, sequence)
        if attempt.motion is not None:
            good.append(_verified(run, attempt.motion))
        return attempt.reason

    run_from_start(scene, seed, carry)  # builds the program
    good.clear()
    found = [run_from_start(scene, seed + number, carry) for number in range(starts)]
    return _Row(
        rounds,
        searched,
        len(sequences),
        float(np.median(motions)),
        starts,
        float(np.mean([start.num_homotopies for start in found])),
        sum(good),
        float(np.median([start.seconds for start in found])),
        planned,
    )


def _verified(run: TransitionRun, done: CompleteMotion) -> bool:
    """Whether a motion, written as a plan, passes the verification of its file."""
    plan = assemble_plan(run, TransitionResult(done, {}))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "plan.h5"
        write_climb(plan, path)
        return verify(path).passed
