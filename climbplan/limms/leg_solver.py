"""Solving the program of a quadruped with IPOPT through CasADi."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.limms.leg_program import LegProgram
from climbplan.limms.leg_statement import BoxCut, LegCut, LegEnds, LegSample, LegTrace
from climbplan.limms.scene import Scene
from climbplan.limms.statement import Limb
from climbplan.solvers.interruption import Deadline, interruptible

FEASIBLE = 1e-6  # largest violation of an answer that is used


@dataclass(frozen=True)
class LegOutcome:
    """Whether a program was solved, and its answer."""

    solved: bool
    message: str
    traces: tuple[LegTrace, ...]
    violation: float
    objective: float
    seconds: float
    build_seconds: float
    variables: int
    constraints: int


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
    program = LegProgram(scene, limbs)
    for number, trace in enumerate(guess):
        program.phase(
            trace,
            [s for s in samples if s.phase == number],
            [c for c in cuts if c.phase == number],
            ends,
        )
    program.finish(ends)
    store = program.store
    x, g = ca.vertcat(*store.x), ca.vertcat(*store.g)
    deadline = Deadline(x.numel(), g.numel(), 0)
    deadline.at = effort.deadline
    options: dict[str, Any] = {
        "ipopt.print_level": 0,
        "print_time": False,
        "expand": True,
        "error_on_fail": False,
        "iteration_callback": deadline,
        "ipopt.sb": "yes",
        "ipopt.max_iter": effort.iterations,
        "ipopt.tol": 1e-4,
        "ipopt.constr_viol_tol": 1e-7,
        "ipopt.acceptable_tol": 1e-2,
        "ipopt.acceptable_constr_viol_tol": 1e-7,
        "ipopt.acceptable_iter": 4,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.mumps_mem_percent": 200,
    }
    if effort.warm:
        options |= {"ipopt.mu_init": 1e-3, "ipopt.bound_push": 1e-5, "ipopt.bound_frac": 1e-5}
    problem = {"x": x, "f": program.cost, "g": g}
    solver = ca.nlpsol("legs", "ipopt", problem, options)
    built = time.perf_counter()
    low, high = np.concatenate(store.g_low), np.concatenate(store.g_high)
    with interruptible(deadline.stop):
        answer = solver(
            x0=np.concatenate(store.start),
            lbx=np.concatenate(store.low),
            ubx=np.concatenate(store.high),
            lbg=low,
            ubg=high,
        )
    values = np.asarray(answer["g"]).ravel()
    violation = float(np.maximum(low - values, values - high).max())
    stats = solver.stats()
    read = ca.Function("read", [x], program.outputs)(answer["x"])
    status = f"{stats['return_status']}, {stats['iter_count']} iterations"
    return LegOutcome(
        solved=violation <= FEASIBLE,  # whatever the solver says of optimality
        message=f"{status}, violation {violation:.1e}",
        traces=program.traces([np.asarray(v) for v in read], guess),
        violation=violation,
        objective=float(answer["f"]),
        seconds=time.perf_counter() - built,
        build_seconds=built - began,
        variables=int(x.numel()),
        constraints=int(g.numel()),
    )
