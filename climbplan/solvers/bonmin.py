"""Bonmin through CasADi: branch and bound over nonlinear programs, as a baseline.

Bonmin overruns its own time limit and writes to the terminal from compiled code. It therefore runs
in a child process, which is ended at the time limit. Its bounds are not valid for nonconvex
programs.
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
from climbplan.reformulations.nlp_form import NlpOptions, build_nlp_form
from climbplan.solvers.ipopt.instances import TOLERANCE, compute_box_center, solve_fixed_integers
from climbplan.solvers.result import Answer, SolverResult, judge_answer

NAME = "bonmin"
_GRACE = 0.05  # time after the limit for Bonmin's last node, as a fraction of the limit
_POLL_INTERVAL = 0.01  # time between checks of the process [s]
_PROGRAM, _NUMBERS, _ANSWER = "program.casadi", "numbers.npz", "answer.npy"
_DIE_WITH_PARENT = 1  # prctl's PR_SET_PDEATHSIG
_STARTED, _ERRORS = "begun", "errors.txt"


def solve_bonmin(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
) -> SolverResult:
    """Solve an instance with integers by Bonmin, implications and choices by big-M.

    The program at its integers is solved again, which removes the relaxation of big-M. An incumbent
    is lost when the time limit [s] ends the process before Bonmin itself stops. The status is
    "feasible" or "limit".

    Raises:
        UsageError: Big-M lacks a bound.
    """
    begin = time.monotonic()
    deadline = begin + time_limit
    form = build_nlp_form(instance, NlpOptions("big-m"))
    bounds = form.compute_relaxed_bounds(instance, eps=1.0)  # integrality is Bonmin's own
    nlp_start = compute_box_center(instance) if start is None else start
    num_extra = form.size - instance.size
    integer = np.zeros(form.size, bool)
    integer[form.binaries] = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ca.Function("program", [form.v, form.p], [form.f, form.g]).save(str(folder / _PROGRAM))
        np.savez(
            folder / _NUMBERS,
            p=form.build_parameters(instance),
            integer=integer,
            start=np.concatenate([nlp_start, np.full(num_extra, 0.5)]),
            lower=bounds.lower,
            upper=bounds.upper,
            row_lower=bounds.row_lower,
            row_upper=bounds.row_upper,
            time_limit=max(deadline - time.monotonic(), 0.0),
            gap=gap,
        )
        solution, message = _run_process(folder, deadline)
    x = None
    chosen = np.zeros(0, np.int64)
    if solution is not None:
        ends = np.cumsum([instance.size, *form.structure.choices])
        selected = [int(np.argmax(solution[a:b])) for a, b in pairwise(ends)]
        chosen = np.array(selected, np.int64)
        x = solve_fixed_integers(instance, solution[: instance.size], chosen, deadline).v
    answer = Answer(
        x=x,
        bound=-np.inf,
        infeasible=False,
        nodes=0,
        time=time.monotonic() - begin,
        solver=NAME,
        log=(f"Bonmin: {message}",),
        assignment=chosen,
    )
    return judge_answer(instance, answer, gap, tolerance)


def _run_process(folder: Path, deadline: float) -> tuple[Array | None, str]:
    """Return Bonmin's point (N,) and its message; no point if the process had to be ended.

    Bonmin has the time from its start, without imports, until `deadline` (`time.monotonic` [s]),
    and a fraction `_GRACE` more for its last node.
    """
    command = [sys.executable, "-m", "climbplan.solvers.bonmin", str(folder)]
    time_left = max(deadline - time.monotonic(), 0.0)
    kill_time = np.inf
    with (folder / _ERRORS).open("wb") as errors:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
    try:
        while process.poll() is None and time.monotonic() < kill_time:
            if np.isinf(kill_time) and (folder / _STARTED).exists():
                kill_time = time.monotonic() + (1.0 + _GRACE) * time_left
            time.sleep(_POLL_INTERVAL)
        if process.poll() is None:
            return None, "ended: it overran its time limit"
    finally:
        process.kill()
        process.wait()
    if process.returncode != 0 or not (folder / _ANSWER).exists():
        error_lines = (folder / _ERRORS).read_text(errors="replace").strip().splitlines()
        return None, error_lines[-1] if error_lines else "no answer"
    return np.load(folder / _ANSWER), "stopped by itself"


def _solve_in_child(folder: Path) -> None:
    """Solve the program in the folder and write the answer there, in the child process.

    The child ends with its parent process.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    problem = np.load(folder / _NUMBERS)
    program = ca.Function.load(str(folder / _PROGRAM))
    v = ca.SX.sym("v", len(problem["start"]))
    f, g = program(v, problem["p"])
    options = {"discrete": problem["integer"].tolist(), "error_on_fail": False}
    options["bonmin"] = {"allowable_fraction_gap": float(problem["gap"])}
    if np.isfinite(problem["time_limit"]):
        options["bonmin"]["time_limit"] = float(problem["time_limit"])
    solver = ca.nlpsol("bonmin", "bonmin", {"x": v, "f": f, "g": g}, options)
    (folder / _STARTED).touch()
    answer = solver(
        x0=problem["start"],
        lbx=problem["lower"],
        ubx=problem["upper"],
        lbg=problem["row_lower"],
        ubg=problem["row_upper"],
    )
    np.save(folder / _ANSWER, np.array(answer["x"]).ravel())


if __name__ == "__main__":
    _solve_in_child(Path(sys.argv[1]))
