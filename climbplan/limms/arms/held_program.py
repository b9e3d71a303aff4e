"""Programs of arms that carry or throw the box, from several initial guesses."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from climbplan.limms.arms.branch_choices import HeldTask
from climbplan.limms.arms.collision_cuts import solve_with_cuts
from climbplan.limms.arms.guess import generate_guesses
from climbplan.limms.arms.program import solve_arms
from climbplan.limms.budget.program_results import BoundaryConditions, CollisionCut, ProgramOutcome
from climbplan.limms.budget.solver_work import Work
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import PhaseTrajectory, SupportModule

MAX_ITERATIONS = 600  # of IPOPT, for all programs of one choice of branches
MAX_ITERATIONS_PER_PROGRAM = 100  # for one of them


def solve_held_stage(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    task: HeldTask,
    deadline: float,
    initial_guess: Sequence[PhaseTrajectory] | None = None,
) -> ProgramOutcome:
    """Solve the program of one held stage from several guesses until one leads to an optimum.

    Args:
        scene: The scene.
        limbs: The arms.
        task: The task.
        deadline: Time at which no program continues, as `time.monotonic` [s].
        initial_guess: The only guess; None generates them.

    Returns:
        The first optimum, else the best solution, else the last failure, with the work of all.
    """
    ends = BoundaryConditions(task.start, task.goal, task.arrival_speed if task.throw else 0.0)
    work = Work()
    best: ProgramOutcome | None = None
    for start_guess in (
        [list(initial_guess)] if initial_guess else generate_guesses(scene, limbs, task)
    ):

        def solve_program(
            guess: Sequence[PhaseTrajectory] | None,
            cuts: Sequence[CollisionCut],
            start_guess: list[PhaseTrajectory] = start_guess,
        ) -> ProgramOutcome:
            nonlocal work
            iterations = min(MAX_ITERATIONS_PER_PROGRAM, max(MAX_ITERATIONS - work.iterations, 1))
            outcome = solve_arms(
                scene,
                limbs,
                guess or start_guess,
                ends,
                cuts=cuts,
                deadline=deadline,
                iterations=iterations,
            )
            work += outcome.work
            return outcome

        outcome = solve_with_cuts(scene, limbs, solve_program)
        if best is None or _rank(outcome) < _rank(best):
            best = outcome
        if outcome.is_optimal or work.iterations >= MAX_ITERATIONS or time.monotonic() > deadline:
            break
    assert best is not None
    return replace(best, work=work)


def _rank(outcome: ProgramOutcome) -> tuple[bool, bool, float]:
    """Return the sort key: optima first, then feasible solutions, the cheapest first."""
    return (not outcome.is_optimal, not outcome.solved, outcome.objective)
