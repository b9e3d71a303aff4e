"""Whether a signal or the clock stopped SCIP."""

from __future__ import annotations

import os
import signal
import threading
import time

import numpy as np
import pytest

from climbplan.program import Program
from climbplan.solvers.registry import solve
from climbplan.solvers.scip.run import run_model


class Endless:
    """A model that is solved until something interrupts it, and does not ask Python meanwhile."""

    def __init__(self, signalled: signal.Signals | None = None) -> None:
        self.settings: dict[str, object] = {}
        self.signalled = signalled
        self.interrupted = threading.Event()

    def setParam(self, name: str, value: object) -> None:
        self.settings[name] = value

    def optimizeNogil(self) -> None:
        if self.signalled is not None:
            os.kill(os.getpid(), self.signalled)
        assert self.interrupted.wait(30.0)

    def interruptSolve(self) -> None:
        self.interrupted.set()


class BetweenStages(Endless):
    """A model that refuses its first interruptions, as SCIP does between presolving and search."""

    refusals = 2

    def interruptSolve(self) -> None:
        if self.refusals:
            self.refusals -= 1
            raise Exception("SCIP: method cannot be called at this time in solution process!")
        super().interruptSolve()


def test_scip_is_asked_again_where_it_cannot_be_interrupted_yet() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    model = BetweenStages(signal.SIGINT)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_model(model, 1e-3, 0.0, np.inf)
    finally:
        signal.signal(signal.SIGINT, before)
    assert model.interrupted.is_set()


def test_ctrl_c_interrupts_scip_and_is_passed_on() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    model = Endless(signal.SIGINT)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_model(model, 1e-4, 1e-5, 60.0)
    finally:
        signal.signal(signal.SIGINT, before)
    assert model.interrupted.is_set()
    assert model.settings["misc/catchctrlc"] is False


def test_sigterm_too() -> None:
    class Ended(Exception):
        """What a program makes of SIGTERM."""

    def end(*_: object) -> None:
        raise Ended

    before = signal.signal(signal.SIGTERM, end)
    model = Endless(signal.SIGTERM)
    try:
        with pytest.raises(Ended):
            run_model(model, 1e-4, 1e-5, 60.0)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert model.interrupted.is_set()


def test_the_guard_of_the_limit_is_no_interrupt() -> None:
    model = Endless()
    begin = time.monotonic()
    run_model(model, 1e-4, 1e-5, 0.0)
    assert time.monotonic() - begin < 20.0
    assert model.settings["limits/time"] == 0.0
    assert model.settings["limits/gap"] == pytest.approx(9e-5)


def test_what_fails_in_scip_is_raised() -> None:
    model = Endless()

    def fail() -> None:
        raise MemoryError("presolve")

    model.optimizeNogil = fail  # type: ignore[method-assign]
    with pytest.raises(MemoryError, match="presolve"):
        run_model(model, 1e-4, 1e-5, 60.0)


@pytest.mark.slow
def test_many_runs_in_one_process() -> None:
    """More than the 64 threads that SCIP's derivatives can tell apart."""
    p = Program("area")
    x = p.continuous("x", (2,), 0.25, 4.0)
    p.equal("area", x[0] * x[1] - 1.0)
    p.minimise("distance", np.sum((x - np.array([3.0, 0.5])) ** 2))
    for _ in range(70):
        found = solve(p.instantiate(), "minlp-scip", gap=1e-3, time_limit=20.0)
        assert found.x is not None
