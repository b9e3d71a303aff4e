"""DAQP's own mixed-integer mode on the condensed cart-pole, with plain big-M: a contender.

States are eliminated by their dynamics, binaries are DAQP's. It needs a curved cost, so directions
without cost get a little of it; the point it returns is judged on the statement.
"""

from __future__ import annotations

import time
from ctypes import c_int

import daqp
import numpy as np

from climbplan.program.blocks import Variable
from climbplan.program.instance import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.result import Answer, SolverResult, judge_answer

NAME = "daqp, own integers"
_CURVATURE = 1e-7  # of directions without cost, beside 2.5e-3 of states and inputs
_BINARY = 16  # DAQP's flag
_TOLERANCE = 1e-5


def solve_daqp_mode(instance: Instance, state: Variable, gap: float) -> SolverResult:
    """Its answer; state: the block that the equations determine. It has no bound to show.

    Its time [s] is processor time of DAQP alone: a controller would condense the problem once.
    """
    form = BigM().apply(instance).instance
    A = form.A.toarray()
    equal = form.row_lower == form.row_upper
    gone = np.zeros(form.size, bool)
    gone[state.start : state.stop] = True
    # x = T y + t with y everything but states
    square = A[np.ix_(equal, gone)]
    T, t = np.zeros((form.size, int((~gone).sum()))), np.zeros(form.size)
    T[~gone] = np.eye(T.shape[1])
    T[gone] = -np.linalg.solve(square, A[np.ix_(equal, ~gone)])
    t[gone] = np.linalg.solve(square, form.row_lower[equal])
    P = form.P.toarray()
    H = T.T @ P @ T + _CURVATURE * np.eye(T.shape[1])
    f = T.T @ (form.q + P @ t)
    rows, at = np.vstack([T[gone], A[~equal] @ T]), np.concatenate([t[gone], A[~equal] @ t])
    low = np.concatenate([form.lower[gone], form.row_lower[~equal]]) - at
    high = np.concatenate([form.upper[gone], form.row_upper[~equal]]) - at
    sense = np.zeros(T.shape[1] + len(rows), c_int)
    sense[: T.shape[1]][form.integer[~gone]] = _BINARY
    begin = time.process_time()
    y, _, code, info = daqp.solve(
        H,
        f,
        np.ascontiguousarray(rows),
        np.minimum(np.concatenate([form.upper[~gone], high]), 1e30),
        np.maximum(np.concatenate([form.lower[~gone], low]), -1e30),
        sense,
    )
    spent = time.process_time() - begin
    x = None
    if code > 0:
        x = T @ np.asarray(y) + t
        x[form.integer] = np.round(x[form.integer])
    answer = Answer(
        None if x is None else x[: instance.size],
        -np.inf,
        False,
        int(info.get("nodes", 0)),
        spent,
        NAME,
        (f"DAQP: {code}",),
    )
    return judge_answer(instance, answer, gap, _TOLERANCE)
