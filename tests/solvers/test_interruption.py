"""Ctrl-C during a compiled solver reaches the caller."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import casadi as ca
import pytest

from climbplan.solvers.interruption import Deadline, interruptible


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
