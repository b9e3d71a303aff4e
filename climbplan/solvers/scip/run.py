"""A SCIP model solved on one thread until a gap or a time is reached, and what it then claims."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.interruption import run_aside
from climbplan.solvers.result import Answer

_CLAIMS = {  # SCIP's word -> whether it claims infeasibility
    "optimal": False,
    "gaplimit": False,
    "timelimit": False,
    "userinterrupt": False,
    "nodelimit": False,
    "memlimit": False,
    "infeasible": True,
    "inforunbd": False,
    "unbounded": False,
}
_GRACE = 0.05  # of the time limit, after which SCIP is stopped: presolving does not look at it


def run_model(model: Any, gap: float, own_error: float, time_limit: float) -> None:
    """Solve to a relative gap, of which SCIP's own error is a part; time_limit: [s].

    Ctrl-C and SIGTERM end it and are passed on.
    """
    model.setParam("misc/catchctrlc", False)  # SCIP's own handler would hide it from Python
    model.setParam("parallel/maxnthreads", 1)
    model.setParam("limits/gap", max(gap - own_error, 0.5 * gap))
    guard: threading.Timer | None = None
    if np.isfinite(time_limit):
        model.setParam("limits/time", float(max(time_limit, 0.0)))
        guard = threading.Timer((1.0 + _GRACE) * max(time_limit, 0.0), model.interruptSolve)
        guard.daemon = True
        guard.start()
    try:
        run_aside(model.optimizeNogil, model.interruptSolve)
    finally:
        if guard is not None:
            guard.cancel()


def values(model: Any, variables: list[Any]) -> Array:
    """Their values in the best solution, of which there is one."""
    best = model.getBestSol()
    return np.array([model.getSolVal(best, v) for v in variables])


def claim(
    model: Any, name: str, begin: float, x: Array | None, assignment: IntArray | None = None
) -> Answer:
    """What SCIP says, with a point (n,) that was read from it; begin: of all, by `perf_counter`."""
    status, bound = model.getStatus(), float(model.getDualbound())
    return Answer(
        x=x,
        bound=bound if abs(bound) < model.infinity() else -np.inf,
        infeasible=_CLAIMS.get(status, False) and x is None,
        nodes=int(model.getNTotalNodes()),
        time=time.perf_counter() - begin,
        solver=name,
        log=(f"SCIP {model.version()}: {status}",),
        assignment=assignment,
    )
