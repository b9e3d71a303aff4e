"""SCIP as an independent solver of instances."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from climbplan.program.instance import Instance
from climbplan.solvers.result import SolverResult, judge_answer
from climbplan.solvers.scip.model import build_convex_model
from climbplan.solvers.scip.run import read_answer, read_values, run_model
from climbplan.solvers.tree.repair import repair_point

NAME = "scip"
TOLERANCE = 2e-6  # SCIP works to 1e-6 in each row, and stalls with smaller tolerances
_SCIP_ERROR = 1e-4  # relative error of SCIP's objective through its row tolerance


@contextmanager
def _drop_lp_warnings() -> Iterator[None]:
    """Keep SCIP's LP solver from writing to standard error for every tolerance it rounds.

    It writes from C and bypasses every message handler, so the file descriptor itself is
    redirected.
    """
    sys.stderr.flush()
    original = os.dup(2)
    null_device = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null_device, 2)
        yield
    finally:
        os.dup2(original, 2)
        os.close(original)
        os.close(null_device)


def solve_scip(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
) -> SolverResult:
    """Solve an instance with SCIP on one thread.

    Args:
        instance: Convex instance with choices.
        gap: Relative gap at which SCIP stops.
        time_limit: Time limit of solving [s].
        tolerance: Largest violation at which SCIP's point is accepted.

    Raises:
        UsageError: A choice is not bounded.
    """
    begin = time.perf_counter()
    scip = build_convex_model(instance)
    with _drop_lp_warnings():
        run_model(scip.model, gap, _SCIP_ERROR, time_limit - (time.perf_counter() - begin))
    x = None
    if scip.model.getNSols() > 0:
        x = repair_point(instance, read_values(scip.model, scip.x))
    return judge_answer(instance, read_answer(scip.model, NAME, begin, x), gap, tolerance)
