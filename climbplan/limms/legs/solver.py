"""Solution of the program of a quadruped with IPOPT through CasADi."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from climbplan.limms.budget.solver_work import Work, measure_work
from climbplan.limms.legs.leg_phases import BoxCut, LegBoundary, LegCut, LegSample, LegTrajectory
from climbplan.limms.legs.program import LegProgram
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule
from climbplan.solvers.ipopt.staged_program import solve_staged_program


@dataclass(frozen=True)
class LegProgramOutcome:
    """The solution of a program, and whether it was solved."""

    solved: bool
    message: str
    traces: tuple[LegTrajectory, ...]
    violation: float
    objective: float
    variables: int
    constraints: int
    work: Work  # of all programs solved for this outcome


@dataclass(frozen=True)
class SolverLimits:
    """The limits of one program."""

    deadline: float  # `time.monotonic` [s]
    iterations: int
    is_warm: bool = False  # the guess solves nearly the same program


def solve_legs(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    guess: Sequence[LegTrajectory],
    ends: LegBoundary,
    *,
    samples: Sequence[LegSample],
    cuts: Sequence[LegCut | BoxCut],
    limits: SolverLimits,
) -> LegProgramOutcome:
    """Build and solve the program of a contact sequence from a guess, which carries its phases."""
    start_time = time.perf_counter()
    program = LegProgram(scene, limbs, any(trajectory.phase.swing for trajectory in guess))
    for index, trajectory in enumerate(guess):
        program.add_phase(
            trajectory,
            [s for s in samples if s.phase == index],
            [c for c in cuts if c.phase == index],
            ends,
        )
    program.finish(ends)
    settings: dict[str, Any] = {
        "max_iter": limits.iterations,
        "tol": 1e-4,
        "constr_viol_tol": 1e-7,
        "acceptable_tol": 1e-2,
        "acceptable_constr_viol_tol": 1e-7,
        "acceptable_iter": 4,
        "mu_strategy": "adaptive",
        "mumps_mem_percent": 200,
    }
    if limits.is_warm:
        settings |= {"mu_init": 1e-3, "bound_push": 1e-5, "bound_frac": 1e-5}
    answer = solve_staged_program(
        program.store,
        program.outputs,
        settings,
        start_time,
        limits.deadline,
        expand=True,
    )
    return LegProgramOutcome(
        traces=program.read_trajectories(answer.values, guess),
        work=measure_work(answer),
        **answer.figures(),
    )
