"""SCIP as an independent solver of instances."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from climbplan.program.instance import Instance
from climbplan.solvers.mending import mended
from climbplan.solvers.result import Answer, SolverResult, judged
from climbplan.solvers.scip_model import scip_model

NAME = "scip"
STATUS = {  # SCIP's word -> whether it claims infeasibility
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
TOLERANCE = 2e-6  # SCIP works to 1e-6 in each row; asked for less, it stalls
_OWN_ERROR = 1e-4  # relative: how far SCIP's objective may be off through its row tolerance
_GRACE = 1.0  # [s] after the time limit, which SCIP does not look at in presolving


@contextmanager
def _lp_warnings_dropped() -> Iterator[None]:
    """Keep SCIP's LP solver from writing a line to standard error for every tolerance it rounds.

    It writes from C, past every message handler, so the file descriptor itself is turned away.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def solve_scip(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
) -> SolverResult:
    """Solve an instance with SCIP on one thread.

    gap: relative gap at which SCIP stops. time_limit: [s] of solving. tolerance: largest violation
    accepted when SCIP's point is checked. Raises UsageError if the choices are not bounded.
    """
    begin = time.perf_counter()
    built = scip_model(instance)
    model = built.model
    model.setParam("parallel/maxnthreads", 1)
    model.setParam("limits/gap", max(gap - _OWN_ERROR, 0.5 * gap))
    guard: threading.Timer | None = None
    if np.isfinite(time_limit):
        model.setParam("limits/time", float(time_limit))
        guard = threading.Timer(time_limit + _GRACE, model.interruptSolve)
        guard.start()
    with _lp_warnings_dropped():
        model.optimizeNogil()
    if guard is not None:
        guard.cancel()
    status = model.getStatus()
    if status == "userinterrupt" and time.perf_counter() - begin < time_limit:
        raise KeyboardInterrupt  # Ctrl-C, which SCIP takes for itself, and not the guard
    x = None
    if model.getNSols() > 0:
        best = model.getBestSol()
        x = mended(instance, np.array([model.getSolVal(best, v) for v in built.x]))
    bound = float(model.getDualbound())
    answer = Answer(
        x=x,
        bound=bound if abs(bound) < model.infinity() else -np.inf,
        infeasible=STATUS.get(status, False) and x is None,
        nodes=int(model.getNTotalNodes()),
        time=time.perf_counter() - begin,
        solver=NAME,
        log=(f"SCIP {model.version()}: {status}",),
    )
    return judged(instance, answer, gap, tolerance)
