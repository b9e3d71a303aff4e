"""SCIP as an independent solver of instances."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from climbplan.program.instance import Instance
from climbplan.solvers.result import SolverResult, judged
from climbplan.solvers.scip.model import scip_model
from climbplan.solvers.scip.run import claim, run_model, values
from climbplan.solvers.tree.mending import mended

NAME = "scip"
TOLERANCE = 2e-6  # SCIP works to 1e-6 in each row; asked for less, it stalls
_OWN_ERROR = 1e-4  # relative: how far SCIP's objective may be off through its row tolerance


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
    with _lp_warnings_dropped():
        run_model(built.model, gap, _OWN_ERROR, time_limit - (time.perf_counter() - begin))
    x = None
    if built.model.getNSols() > 0:
        x = mended(instance, values(built.model, built.x))
    return judged(instance, claim(built.model, NAME, begin, x), gap, tolerance)
