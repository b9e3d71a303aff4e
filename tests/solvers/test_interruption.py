"""Ctrl-C during a compiled solver reaches the caller."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np
import osqp
import pytest
from scipy import sparse

from climbplan.solvers.convex.osqp import run_osqp
from climbplan.solvers.interruption import (
    Deadline,
    interruptible,
    run_in_thread,
    run_uninterruptible,
)


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    """Whatever a test does to the handler of Ctrl-C is undone."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def press_ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)  # until the handler has run


def test_the_solver_is_stopped_and_the_interrupt_raised_after_it() -> None:
    seen: list[str] = []

    def solve() -> None:
        with interruptible(lambda: seen.append("stopped")):
            press_ctrl_c()
            seen.append("returned")

    with pytest.raises(KeyboardInterrupt):
        solve()
    assert seen == ["stopped", "returned"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ignored_interrupts_stay_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interruptible(lambda: pytest.fail("stopped")):
        press_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_other_threads_leave_the_handler_alone() -> None:
    handlers = []

    def solve() -> None:
        with interruptible(lambda: None):
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=solve)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]


def test_a_signal_that_another_thread_receives_stops_the_solver() -> None:
    run_in_thread(lambda: None, lambda: None)  # starts the solvers' thread, which receives it below
    stopped, in_time = threading.Event(), []

    def solve() -> None:
        press_ctrl_c()
        in_time.append(stopped.wait(10.0))

    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with pytest.raises(KeyboardInterrupt):
            run_in_thread(solve, stopped.set)
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    assert in_time == [True]


class PressedInTheThirdIteration(Deadline):
    """Ctrl-C while IPOPT iterates, at a moment that does not depend on the clock."""

    def __init__(self) -> None:
        super().__init__(2, 0, 0)
        self.iterations = 0

    def eval(self, iterate: Any) -> list[int]:
        """Press, let the handler run, and look at the deadline as always."""
        self.iterations += 1
        if self.iterations == 3:
            press_ctrl_c()
        return super().eval(iterate)


def test_ipopt_stops_at_the_iteration_in_which_ctrl_c_comes() -> None:
    deadline = PressedInTheThirdIteration()
    x = ca.SX.sym("x", 2)
    options = {
        "print_time": False,
        "iteration_callback": deadline,
        "ipopt": {"print_level": 0, "sb": "yes"},
    }
    # A curved valley: it takes IPOPT more than three iterations
    valley = (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2
    solver = ca.nlpsol("valley", "ipopt", {"x": x, "f": valley}, options)

    def solve() -> None:
        with interruptible(deadline.stop):
            solver(x0=[-1.2, 1.0])

    with pytest.raises(KeyboardInterrupt):
        solve()
    assert solver.stats()["return_status"] == "User_Requested_Stop"
    assert deadline.iterations == 3


def test_a_deaf_solver_is_left_behind_and_the_next_one_runs() -> None:
    over, woken = threading.Event(), threading.Event()

    def deaf() -> int:
        press_ctrl_c()
        woken.wait(20.0)
        over.set()
        return 1

    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_uninterruptible(deaf, 10**6)
    assert time.monotonic() - begin < 10.0
    assert not over.is_set()
    names = []
    assert run_uninterruptible(lambda: names.append(threading.current_thread()), 10**6) is None
    assert names[0] is not threading.main_thread()
    woken.set()
    assert over.wait(10.0)


def test_small_programs_are_solved_as_they_stand() -> None:
    assert run_uninterruptible(threading.current_thread, 100) is threading.current_thread()


def test_what_fails_aside_is_raised() -> None:
    def fail() -> None:
        raise MemoryError("factorisation")

    with pytest.raises(MemoryError, match="factorisation"):
        run_uninterruptible(fail, 10**6)


def test_osqp_does_not_keep_ctrl_c_to_itself(capfd: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    rows, price = sparse.csc_matrix(rng.normal(size=(300, 300))), rng.normal(size=300)
    solver = osqp.OSQP()
    endless = {"eps_abs": 1e-16, "eps_rel": 1e-16, "max_iter": 10**8, "verbose": False}
    ones = np.ones(300)
    solver.setup(sparse.identity(300, format="csc"), price, rows, -ones, ones, **endless)
    press = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    press.start()

    def solve() -> None:
        run_osqp(solver, 0)
        time.sleep(5.0)

    with pytest.raises(KeyboardInterrupt):
        solve()
    press.join()
    assert capfd.readouterr().out == ""  # for results
