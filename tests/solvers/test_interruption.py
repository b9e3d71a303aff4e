"""Ctrl-C during a compiled solver reaches the caller."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator

import casadi as ca
import pytest

from climbplan.climb.postures.nlp_statement import Deadline
from climbplan.solvers.interruption import interruptible


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


def test_ipopt_stops_at_its_next_iteration() -> None:
    deadline = Deadline(2, 0, 0)
    x = ca.SX.sym("x", 2)
    options = {
        "print_time": False,
        "iteration_callback": deadline,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 10_000, "tol": 1e-300},
    }
    # Without a minimum IPOPT goes on to its iteration limit
    solver = ca.nlpsol("endless", "ipopt", {"x": x, "f": -ca.sum1(x)}, options)

    def solve() -> None:
        threading.Timer(0.05, press_ctrl_c).start()
        with interruptible(deadline.stop):
            while deadline.at > 0:
                solver(x0=[0.0, 0.0])

    with pytest.raises(KeyboardInterrupt):
        solve()
    assert solver.stats()["return_status"] == "User_Requested_Stop"
