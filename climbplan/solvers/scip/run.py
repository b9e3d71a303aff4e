"""Run a SCIP model on one thread until a gap or time limit, and read its answer."""

from __future__ import annotations

import threading
import time
from contextvars import copy_context
from functools import partial
from typing import Any

import numpy as np
from pyscipopt import Eventhdlr
from pyscipopt.scip import PY_SCIP_EVENTTYPE as EVENTS

from climbplan.arrays import Array, IntArray
from climbplan.progress import is_observed, report_search
from climbplan.solvers.interruption import run_in_thread
from climbplan.solvers.result import Answer

_CLAIMS = {  # SCIP's status -> whether it claims infeasibility
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
_EVENTS = (EVENTS.BESTSOLFOUND, EVENTS.NODESOLVED)
_REPORT_INTERVAL = 0.2  # [s] between reports of nodes
_NOT_NOW = "cannot be called at this time"  # of an error of SCIP
_INTERRUPTION_TIME = 5.0  # [s] for which SCIP is asked again
_INTERRUPTION_INTERVAL = 0.02  # [s]
_GRACE = 0.05  # fraction of the time limit after which SCIP is stopped, as presolving ignores it


class _SearchReporter(Eventhdlr):
    """Reports incumbent and bound of SCIP, which runs in another thread, to the run's meter."""

    def __init__(self) -> None:
        self._context = copy_context()
        self._next_report = 0.0  # [s] monotonic

    def eventinit(self) -> None:
        """Begin to receive events."""
        for event in _EVENTS:
            self.model.catchEvent(event, self)

    def eventexit(self) -> None:
        """Receive no more events."""
        for event in _EVENTS:
            self.model.dropEvent(event, self)

    def eventexec(self, event: Any) -> None:
        """Report what is known after a node or an incumbent."""
        now = time.monotonic()
        if event.getType() == EVENTS.BESTSOLFOUND or now >= self._next_report:
            self._next_report = now + _REPORT_INTERVAL
            self._context.run(_report_figures, self.model)


def _report_figures(model: Any) -> None:
    """Report primal and dual bound of a model; SCIP's infinity is a large number."""
    figures = (model.getPrimalbound(), model.getDualbound())
    report_search(*(None if abs(f) >= model.infinity() else float(f) for f in figures))


def run_model(model: Any, gap: float, scip_error: float, time_limit: float) -> None:
    """Solve to a relative gap, of which SCIP's own error is a part.

    Ctrl-C and SIGTERM end it and are passed on.

    Args:
        model: The model.
        gap: Relative gap.
        scip_error: Relative error of SCIP's objective.
        time_limit: Time limit [s].
    """
    model.setParam("misc/catchctrlc", False)  # SCIP's own handler would hide it from Python
    model.setParam("parallel/maxnthreads", 1)
    model.setParam("limits/gap", max(gap - scip_error, 0.5 * gap))
    timer: threading.Timer | None = None
    if np.isfinite(time_limit):
        model.setParam("limits/time", float(max(time_limit, 0.0)))
        timer = threading.Timer((1.0 + _GRACE) * max(time_limit, 0.0), _interrupt, [model])
        timer.daemon = True
        timer.start()
    if is_observed():
        model.includeEventhdlr(_SearchReporter(), "report_search", "reports incumbent and bound")
    try:
        run_in_thread(model.optimizeNogil, partial(_interrupt, model))
    finally:
        if timer is not None:
            timer.cancel()
    if is_observed():
        _report_figures(model)


def _interrupt(model: Any) -> None:
    """Let SCIP end, which refuses to in the moment between presolving and its search."""
    deadline = time.monotonic() + _INTERRUPTION_TIME
    while True:
        try:
            model.interruptSolve()
            return
        except Exception as error:  # SCIP's errors have no type of their own
            if _NOT_NOW not in str(error) or time.monotonic() > deadline:
                raise
        time.sleep(_INTERRUPTION_INTERVAL)


def read_values(model: Any, variables: list[Any]) -> Array:
    """Return values of variables in the best solution, of which there is one."""
    best = model.getBestSol()
    return np.array([model.getSolVal(best, v) for v in variables])


def read_answer(
    model: Any, name: str, begin: float, x: Array | None, assignment: IntArray | None = None
) -> Answer:
    """Return SCIP's answer with a point (n,); `begin` is the start by `time.perf_counter` [s]."""
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
