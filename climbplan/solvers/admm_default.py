"""ADMM with what it needs chosen: big-M rows, HiGHS, one envelope a product."""

from __future__ import annotations

import time

import numpy as np

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.admm import AdmmOptions, solve_admm
from climbplan.solvers.highs.instances import solve_highs
from climbplan.solvers.result import SolverResult

_BLOCK_GAP = 1e-3  # the next consensus moves the block anyway


def solve_admm_default(
    instance: Instance, gap: float = 1e-4, time_limit: float = np.inf
) -> SolverResult:
    """A feasible point by ADMM without further choices; `solve_admm` takes them.

    Status is "feasible" or "limit". Raises UsageError where big-M lacks a bound.
    """
    begin = time.perf_counter()

    def mixed_integer(block: Instance) -> Array | None:
        disjoined = BigM().apply(block)
        left = max(time_limit - (time.perf_counter() - begin), 0.1)
        found = solve_highs(disjoined.instance, _BLOCK_GAP, left)
        return None if found.x is None else disjoined.invert(found.x)

    options = AdmmOptions(freeze_after=2)
    return solve_admm(
        instance, mixed_integer, options=options, gap=gap, time_limit=time_limit
    ).result
