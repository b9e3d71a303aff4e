"""Planning of a quadruped: contact sequences, and programs solved until valid between knots."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.limms.budget.solver_work import Work
from climbplan.limms.legs.gaits import SwingPattern
from climbplan.limms.legs.guess import build_leap_guess, build_leg_guess
from climbplan.limms.legs.leaps import find_leaps
from climbplan.limms.legs.leg_phases import BoxCut, LegBoundary, LegCut, LegSample, LegTrajectory
from climbplan.limms.legs.motion import compute_leg_motion
from climbplan.limms.legs.solver import LegProgramOutcome, SolverLimits, solve_legs
from climbplan.limms.legs.standing import build_legs, find_stance_sets
from climbplan.limms.legs.violations import find_violations
from climbplan.limms.modules.limbs import build_leg
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule

MAX_ROUNDS = 8
FINER = 4  # times the density of a plan's samples, for checks between knots
ITERATIONS = 150


@dataclass(frozen=True)
class InitialGuess:
    """Legs with their branches, and a guess of their motion."""

    limbs: tuple[SupportModule, ...]
    guess: tuple[LegTrajectory, ...]


def generate_starts(
    scene: ModuleScene,
    gait: SwingPattern,
    corridor: Corridor,
    rng: np.random.Generator,
    *,
    deadline: float,
    max_starts: int = 2,
) -> Iterator[InitialGuess]:
    """Yield guesses of a contact sequence from start to goal of the box, the best first.

    Args:
        scene: The scene.
        gait: The contact sequence.
        corridor: The corridor of the box.
        rng: Random generator.
        deadline: Time after which no more are sought, as `time.monotonic` [s].
        max_starts: Largest number of guesses without steps.
    """
    ends = (scene.box_start[0], scene.goal)
    if gait.name == "leap":
        for leap in find_leaps(scene, scene.goal, rng, deadline):
            limbs = tuple(build_leg(side, side, 1, b) for side, b in enumerate(leap.branches))
            yield InitialGuess(limbs, tuple(build_leap_guess(scene, leap, corridor, ends)))
        return
    for stand_set in find_stance_sets(scene, gait, corridor, 1 if gait.steps else max_starts):
        limbs = build_legs(stand_set)
        first = (np.array([s.foot for s in stand_set]), [s.patch for s in stand_set])
        yield InitialGuess(limbs, tuple(build_leg_guess(scene, limbs, gait, corridor, ends, first)))


def solve_until_valid(
    scene: ModuleScene,
    start: InitialGuess,
    ends: LegBoundary,
    deadline: float,
    iterations: int = ITERATIONS,
) -> LegProgramOutcome:
    """Solve a program, add violations between its knots, and solve again.

    `solved` of the outcome says that no violation is left.

    Args:
        scene: The scene.
        start: Legs and initial guess.
        ends: Boundary conditions.
        deadline: Time limit as `time.monotonic` [s].
        iterations: Largest number of iterations of each program.
    """
    samples: list[LegSample] = []
    cuts: list[LegCut | BoxCut] = []
    guess: Sequence[LegTrajectory] = start.guess
    work = Work()
    outcome = None
    for round_index in range(MAX_ROUNDS):
        effort = SolverLimits(deadline, iterations, is_warm=round_index > 0)
        outcome = solve_legs(
            scene, start.limbs, guess, ends, samples=samples, cuts=cuts, limits=effort
        )
        work += outcome.work
        outcome = replace(outcome, work=work)
        if not outcome.solved:
            return outcome
        messages: list[str] = []
        for k, trajectory in enumerate(outcome.traces):
            motion = compute_leg_motion(scene, start.limbs, trajectory, finer=FINER)
            violations = find_violations(scene, start.limbs, k, trajectory, motion)
            samples += violations.samples
            cuts += violations.cuts
            messages += violations.messages
        if not messages:
            return outcome
        guess = outcome.traces
        if time.monotonic() > deadline:
            break
    assert outcome is not None
    message = f"still wrong between knots after {MAX_ROUNDS} programs: {messages[0]}"
    return replace(outcome, solved=False, message=message)
