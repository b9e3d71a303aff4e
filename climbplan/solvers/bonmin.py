"""Bonmin through CasADi: branch and bound over nonlinear programs, a baseline.

It overruns its own time limit and writes to the terminal from compiled code, so it runs in a
process of its own, which is ended when its time is over. On nonconvex programs its bound is none.
"""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.reformulations.nlp_form import Manner, nlp_form
from climbplan.solvers.ipopt.instances import TOLERANCE, middle, solve_pinned
from climbplan.solvers.result import Answer, SolverResult, judged

NAME = "bonmin"
_GRACE = 0.05  # of the time limit, beyond it: for Bonmin's last node
_LOOK = 0.01  # [s] between looks at the process
_PROGRAM, _NUMBERS, _ANSWER = "program.casadi", "numbers.npz", "answer.npy"
_DIE_WITH_PARENT = 1  # prctl's PR_SET_PDEATHSIG
_BEGUN, _ERRORS = "begun", "errors.txt"


def solve_bonmin(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
) -> SolverResult:
    """Solve an instance with integers by Bonmin, implications and choices by big-M.

    Its integers are kept and the pinned program is solved again, which removes what leaks through
    big-M. An incumbent is lost when the time limit [s] ends the process before Bonmin itself
    stops. Status is "feasible" or "limit". Raises UsageError where big-M lacks a bound.
    """
    begin = time.monotonic()
    deadline = begin + time_limit
    form = nlp_form(instance, Manner("big-m"))
    bounds = form.relaxed_bounds(instance, eps=1.0)  # integrality is Bonmin's own
    first = middle(instance) if start is None else start
    extra = form.size - instance.size
    integer = np.zeros(form.size, bool)
    integer[form.binaries] = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ca.Function("program", [form.v, form.p], [form.f, form.g]).save(str(folder / _PROGRAM))
        np.savez(
            folder / _NUMBERS,
            p=form.numbers(instance),
            integer=integer,
            start=np.concatenate([first, np.full(extra, 0.5)]),
            lower=bounds.lower,
            upper=bounds.upper,
            row_lower=bounds.row_lower,
            row_upper=bounds.row_upper,
            time_limit=max(deadline - time.monotonic(), 0.0),
            gap=gap,
        )
        found, word = _run(folder, deadline)
    x = None
    chosen = np.zeros(0, np.int64)
    if found is not None:
        ends = np.cumsum([instance.size, *form.structure.choices])
        picks = [int(np.argmax(found[a:b])) for a, b in pairwise(ends)]
        chosen = np.array(picks, np.int64)
        x = solve_pinned(instance, found[: instance.size], chosen, deadline).v
    answer = Answer(
        x=x,
        bound=-np.inf,
        infeasible=False,
        nodes=0,
        time=time.monotonic() - begin,
        solver=NAME,
        log=(f"Bonmin: {word}",),
        assignment=chosen,
    )
    return judged(instance, answer, gap, tolerance)


def _run(folder: Path, deadline: float) -> tuple[Array | None, str]:
    """Bonmin's point (N,) and its last word; no point if it had to be ended.

    deadline: `time.monotonic` [s]; Bonmin has the time from its start, imports left out, until then
    and `_GRACE` of it for its last node.
    """
    command = [sys.executable, "-m", "climbplan.solvers.bonmin", str(folder)]
    left = max(deadline - time.monotonic(), 0.0)
    until = np.inf
    with (folder / _ERRORS).open("wb") as errors:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
    try:
        while process.poll() is None and time.monotonic() < until:
            if np.isinf(until) and (folder / _BEGUN).exists():
                until = time.monotonic() + (1.0 + _GRACE) * left
            time.sleep(_LOOK)
        if process.poll() is None:
            return None, "ended: it overran its time limit"
    finally:
        process.kill()
        process.wait()
    if process.returncode != 0 or not (folder / _ANSWER).exists():
        last = (folder / _ERRORS).read_text(errors="replace").strip().splitlines()
        return None, last[-1] if last else "no answer"
    return np.load(folder / _ANSWER), "stopped by itself"


def _child(folder: Path) -> None:
    """In the process of its own: solve what the folder holds and leave the answer there.

    It ends with the process that started it, however that ends.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    given = np.load(folder / _NUMBERS)
    program = ca.Function.load(str(folder / _PROGRAM))
    v = ca.SX.sym("v", len(given["start"]))
    f, g = program(v, given["p"])
    options = {"discrete": given["integer"].tolist(), "error_on_fail": False}
    options["bonmin"] = {"allowable_fraction_gap": float(given["gap"])}
    if np.isfinite(given["time_limit"]):
        options["bonmin"]["time_limit"] = float(given["time_limit"])
    solver = ca.nlpsol("bonmin", "bonmin", {"x": v, "f": f, "g": g}, options)
    (folder / _BEGUN).touch()
    answer = solver(
        x0=given["start"],
        lbx=given["lower"],
        ubx=given["upper"],
        lbg=given["row_lower"],
        ubg=given["row_upper"],
    )
    np.save(folder / _ANSWER, np.array(answer["x"]).ravel())


if __name__ == "__main__":
    _child(Path(sys.argv[1]))
