"""Arms that carry or throw the box: program after program, until one leads to an optimum."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from climbplan.limms.arms.cuts import solve_clear
from climbplan.limms.arms.guess import guesses_for
from climbplan.limms.arms.held_branches import HeldTask
from climbplan.limms.arms.program import solve_arms
from climbplan.limms.budget.program_results import BoundaryConditions, Cut, ProgramOutcome
from climbplan.limms.budget.solver_work import Work
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb, PhaseTrajectory

ITERATIONS = 600  # of IPOPT, for all programs of one choice of branches
MOST = 100  # for one of them


def plan_held(
    scene: Scene,
    limbs: Sequence[Limb],
    task: HeldTask,
    deadline: float,
    given: Sequence[PhaseTrajectory] | None = None,
) -> ProgramOutcome:
    """Solve the program of one held stage, from guess after guess until one leads to an optimum.

    deadline: `time.monotonic` [s] at which no program goes on; before it, all of them together
    have `ITERATIONS`. given: the only guess to begin from. The outcome is the first optimum, else
    the best answer, else the last try; its work is that of all.
    """
    ends = BoundaryConditions(task.start, task.goal, task.arrival_speed if task.throw else 0.0)
    spent = Work()
    best: ProgramOutcome | None = None
    for first in [list(given)] if given else guesses_for(scene, limbs, task):

        def once(
            guess: Sequence[PhaseTrajectory] | None,
            cuts: Sequence[Cut],
            first: list[PhaseTrajectory] = first,
        ) -> ProgramOutcome:
            nonlocal spent
            most = min(MOST, max(ITERATIONS - spent.iterations, 1))
            outcome = solve_arms(scene, limbs, guess or first, ends, cuts, deadline, most)
            spent += outcome.work
            return outcome

        outcome = solve_clear(scene, limbs, once)
        if best is None or _rank(outcome) < _rank(best):
            best = outcome
        if outcome.is_optimal or spent.iterations >= ITERATIONS or time.monotonic() > deadline:
            break
    assert best is not None
    return replace(best, work=spent)


def _rank(outcome: ProgramOutcome) -> tuple[bool, bool, float]:
    """Optima first, then answers, the cheapest first."""
    return (not outcome.is_optimal, not outcome.solved, outcome.objective)
