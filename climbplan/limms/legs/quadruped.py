"""Solving for a quadruped: contact sequences, and programs solved again until nothing is wrong."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.limms.budget.solver_work import Work
from climbplan.limms.legs.faults import faults_of
from climbplan.limms.legs.gaits import Gait
from climbplan.limms.legs.guess import leap_guess, leg_guess
from climbplan.limms.legs.leaps import find_leaps
from climbplan.limms.legs.motion import leg_motion
from climbplan.limms.legs.solver import Effort, LegOutcome, solve_legs
from climbplan.limms.legs.standing import first_stand_sets, legs_of
from climbplan.limms.legs.statement import BoxCut, LegCut, LegEnds, LegSample, LegTrace
from climbplan.limms.modules.limbs import leg
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb

ROUNDS = 8
FINER = 4  # than a plan's samples: what is looked at between knots
ITERATIONS = 150


@dataclass(frozen=True)
class Start:
    """Legs in their branches, and a guess of their motion."""

    limbs: tuple[Limb, ...]
    guess: tuple[LegTrace, ...]


def starts(
    scene: Scene,
    gait: Gait,
    way: Corridor,
    rng: np.random.Generator,
    deadline: float,
    most: int = 2,
) -> Iterator[Start]:
    """Guesses of a contact sequence from where the box starts to its goal, the best first.

    deadline: `time.monotonic` [s] after which no more are looked for.
    """
    ends = (scene.box_start[0], scene.goal)
    if gait.name == "leap":
        for leap in find_leaps(scene, scene.goal, rng, deadline):
            limbs = tuple(leg(side, side, 1, b) for side, b in enumerate(leap.branches))
            yield Start(limbs, tuple(leap_guess(scene, leap, way, ends)))
        return
    for stands in first_stand_sets(scene, gait, way, 1 if gait.steps else most):
        limbs = legs_of(stands)
        first = (np.array([s.foot for s in stands]), [s.patch for s in stands])
        yield Start(limbs, tuple(leg_guess(scene, limbs, gait, way, ends, first)))


def solve_sound(
    scene: Scene, start: Start, ends: LegEnds, deadline: float, iterations: int = ITERATIONS
) -> LegOutcome:
    """Solve a program, look between its knots, add what is wrong there, and solve again.

    `solved` of the outcome says that nothing is wrong any more. deadline: `time.monotonic` [s].
    """
    samples: list[LegSample] = []
    cuts: list[LegCut | BoxCut] = []
    guess: Sequence[LegTrace] = start.guess
    spent = Work()
    outcome = None
    for number in range(ROUNDS):
        effort = Effort(deadline, iterations, warm=number > 0)
        outcome = solve_legs(scene, start.limbs, guess, ends, samples, cuts, effort)
        spent += outcome.work
        outcome = replace(outcome, work=spent)
        if not outcome.solved:
            return outcome
        words: list[str] = []
        for k, trace in enumerate(outcome.traces):
            motion = leg_motion(scene, start.limbs, trace, finer=FINER)
            found = faults_of(scene, start.limbs, k, trace, motion)
            samples += found.samples
            cuts += found.cuts
            words += found.words
        if not words:
            return outcome
        guess = outcome.traces
        if time.monotonic() > deadline:
            break
    assert outcome is not None
    message = f"still wrong between knots after {ROUNDS} programs: {words[0]}"
    return replace(outcome, solved=False, message=message)
