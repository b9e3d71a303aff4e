"""Solving the program of a quadruped with IPOPT through CasADi."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from climbplan.limms.budget.solver_work import Work, measure_work
from climbplan.limms.legs.program import LegProgram
from climbplan.limms.legs.statement import BoxCut, LegCut, LegEnds, LegSample, LegTrace
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb
from climbplan.solvers.ipopt.trajectory import solve_trajectory


@dataclass(frozen=True)
class LegOutcome:
    """Whether a program was solved, and its answer."""

    solved: bool
    message: str
    traces: tuple[LegTrace, ...]
    violation: float
    objective: float
    variables: int
    constraints: int
    work: Work  # of all programs that were solved for it


@dataclass(frozen=True)
class Effort:
    """How much may be spent on one program."""

    deadline: float  # `time.monotonic` [s]
    iterations: int
    warm: bool = False  # the guess is an answer of nearly the same program


def solve_legs(
    scene: Scene,
    limbs: Sequence[Limb],
    guess: Sequence[LegTrace],
    ends: LegEnds,
    samples: Sequence[LegSample],
    cuts: Sequence[LegCut | BoxCut],
    effort: Effort,
) -> LegOutcome:
    """Build and solve the program of a contact sequence from a guess, which carries its phases."""
    began = time.perf_counter()
    program = LegProgram(scene, limbs, any(trace.phase.swing for trace in guess))
    for number, trace in enumerate(guess):
        program.phase(
            trace,
            [s for s in samples if s.phase == number],
            [c for c in cuts if c.phase == number],
            ends,
        )
    program.finish(ends)
    settings: dict[str, Any] = {
        "max_iter": effort.iterations,
        "tol": 1e-4,
        "constr_viol_tol": 1e-7,
        "acceptable_tol": 1e-2,
        "acceptable_constr_viol_tol": 1e-7,
        "acceptable_iter": 4,
        "mu_strategy": "adaptive",
        "mumps_mem_percent": 200,
    }
    if effort.warm:
        settings |= {"mu_init": 1e-3, "bound_push": 1e-5, "bound_frac": 1e-5}
    answer = solve_trajectory(
        program.store,
        program.outputs,
        settings,
        began,
        effort.deadline,
        expand=True,
    )
    return LegOutcome(
        traces=program.traces(answer.values, guess), work=measure_work(answer), **answer.figures()
    )
