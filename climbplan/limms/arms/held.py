"""Arms that carry or throw the box: program after program, until one leads to an optimum."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from climbplan.limms.arms.answers import Cut, Ends, Outcome
from climbplan.limms.arms.cuts import solve_clear
from climbplan.limms.arms.guess import guesses_for
from climbplan.limms.arms.held_branches import HeldTask
from climbplan.limms.arms.program import solve_arms
from climbplan.limms.scene import Scene
from climbplan.limms.statement import Limb, Trace

TRIES = 3  # guesses of a throw
SECONDS = 20.0  # of the processor for the programs of one choice of branches
LEAST = 0.1  # [s] that a program gets at least


def plan_held(
    scene: Scene,
    limbs: Sequence[Limb],
    task: HeldTask,
    deadline: float,
    given: Sequence[Trace] | None = None,
) -> Outcome:
    """Solve the program of one held stage, from guess after guess until one leads to an optimum.

    deadline: `time.monotonic` [s] at which no program goes on; before it, all of them together
    have `SECONDS` of the processor. given: the only guess to begin from. The outcome is the first
    optimum, else the best answer, else the last try; its times are those of all.
    """
    ends = Ends(task.start, task.goal, task.arrival_speed if task.throw else 0.0)
    spare = time.process_time() + SECONDS
    spent, built = 0.0, 0.0
    best: Outcome | None = None
    some = TRIES if task.throw else 1
    for first in [list(given)] if given else guesses_for(scene, limbs, task)[:some]:

        def once(
            guess: Sequence[Trace] | None, cuts: Sequence[Cut], first: list[Trace] = first
        ) -> Outcome:
            seconds = max(spare - time.process_time(), LEAST)
            until = max(deadline, time.monotonic() + LEAST)
            return solve_arms(scene, limbs, guess or first, ends, cuts, seconds, until)

        outcome = solve_clear(scene, limbs, once)
        spent, built = spent + outcome.seconds, built + outcome.build_seconds
        if best is None or _rank(outcome) < _rank(best):
            best = outcome
        if outcome.optimal or time.monotonic() > deadline:
            break
    assert best is not None
    return replace(best, seconds=spent, build_seconds=built)


def _rank(outcome: Outcome) -> tuple[bool, bool, float]:
    """Optima first, then answers, the cheapest first."""
    return (not outcome.optimal, not outcome.solved, outcome.objective)
