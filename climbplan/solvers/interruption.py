"""Stop a compiled solver: by the clock, by Ctrl-C, and by SIGTERM.

By default CasADi drops exceptions raised by signal handlers and returns as if the solver had been
stopped. Other solvers do not let Python handle signals until they return.
"""

from __future__ import annotations

import math
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

import casadi as ca

Answer = TypeVar("Answer")
_POLL_INTERVAL = 0.1  # time between checks of signals [s]
_DEADLINE_POLL_INTERVAL = 0.005  # time between checks near a deadline [s]
_GRACE = 0.1  # time for a solver to stop at its deadline [s]
_PATIENCE = 0.5  # time after a signal until a solver that cannot be stopped is abandoned [s]
_LARGE_PROGRAM = 20_000  # entries of matrices from which a solver runs in its own thread


@contextmanager
def interruptible(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` on Ctrl-C or SIGTERM, and pass the signal on once the solver has returned.

    Nothing is changed where a signal is not handled in Python, nor outside the main thread, which
    signals do not reach.
    """
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    if threading.current_thread() is not threading.main_thread() or not handlers:
        yield
        return
    received: list[int] = []

    def remember(number: int, _: FrameType | None) -> None:
        received.append(number)
        stop()

    for number in handlers:
        signal.signal(number, remember)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if received:
        handler = handlers[signal.Signals(received[0])]
        assert callable(handler)
        handler(received[0], None)  # raises KeyboardInterrupt, or what the program made of it


def run_in_thread(
    solve: Callable[[], object],
    stop: Callable[[], None],
    patience: float = math.inf,
    deadline: float = math.inf,
) -> bool:
    """Run a solver that releases the GIL in another thread, so that this one handles signals.

    Ctrl-C and SIGTERM call `stop`, which must be safe while the solver runs. They are passed on
    once the solver has returned, or after `patience` [s]. The solver is then abandoned, and nothing
    on which it works may be used again. Exceptions of `solve` are raised here.

    Args:
        solve: Function that runs the solver.
        stop: Function that asks it to stop.
        patience: Time after a signal until it is abandoned [s].
        deadline: Time of `time.monotonic` [s] at which `stop` is called, too; `_GRACE` later the
            solver is abandoned.

    Returns:
        Whether the solver has returned.
    """
    errors: list[BaseException] = []
    abandon_time = math.inf

    def run() -> None:
        try:
            solve()
        except BaseException as error:  # passed on in the thread that waits
            errors.append(error)

    def request_stop() -> None:
        nonlocal abandon_time
        abandon_time = time.monotonic() + patience
        stop()

    thread = _ensure_thread()
    with interruptible(request_stop):
        done = thread.begin(run)
        # Waits are short: a signal just before a wait is handled only after it
        has_returned = False
        while not (
            has_returned := done.wait(
                min(_POLL_INTERVAL, max(deadline - time.monotonic(), _DEADLINE_POLL_INTERVAL))
            )
        ):
            _restore_ctrl_c()
            if time.monotonic() > deadline:
                deadline = math.inf
                abandon_time = min(abandon_time, time.monotonic() + _GRACE)
                stop()
            if time.monotonic() > abandon_time:
                _abandon(thread)
                break
    if errors:
        raise errors[0]
    return has_returned


def _restore_ctrl_c() -> None:
    """Restore Python's handler of Ctrl-C, which OSQP replaces while it runs and polishes."""
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGINT)
        if handler is not None:  # only if Python knows the handler
            signal.signal(signal.SIGINT, handler)


def run_uninterruptible(solve: Callable[[], Answer], work: int) -> Answer:
    """Run a solver that cannot be stopped, such as DAQP, Clarabel and OSQP, and return its answer.

    Small programs are solved in this thread. Larger ones run in another thread, so that Ctrl-C and
    SIGTERM abandon them after half a second. Exceptions of `solve` are raised here. `work` is the
    number of matrix entries.
    """
    if work < _LARGE_PROGRAM:
        return solve()
    answers: list[Answer] = []
    run_in_thread(lambda: answers.append(solve()), lambda: None, _PATIENCE)
    if not answers:
        raise KeyboardInterrupt  # where the program's signal handler has not raised
    return answers[0]


class _SolverThread(threading.Thread):
    """The thread of all solvers that run aside, one after the other.

    There is one thread for all: SCIP's derivatives (CppAD) number every thread permanently and
    crash at the sixty-fifth. It is a daemon, so a solver that ignores `stop` does not keep the
    process alive.
    """

    def __init__(self) -> None:
        super().__init__(name="solver", daemon=True)
        self._jobs: queue.SimpleQueue[tuple[Callable[[], None], threading.Event]]
        self._jobs = queue.SimpleQueue()
        self.process = os.getpid()
        self.is_abandoned = False  # whether it is abandoned with a solver that did not stop

    def run(self) -> None:
        """Run jobs until it is abandoned."""
        while not self.is_abandoned:
            job, done = self._jobs.get()
            try:
                job()
            finally:
                done.set()

    def begin(self, job: Callable[[], None]) -> threading.Event:
        """Run a job that raises nothing; return the event that is set when it is done."""
        done = threading.Event()
        if threading.current_thread() is self:
            job()
            done.set()
        else:
            self._jobs.put((job, done))
        return done


_thread: _SolverThread | None = None
_num_left = 0  # number of abandoned solvers
_starting = threading.Lock()


def _ensure_thread() -> _SolverThread:
    """Return the thread of this process; a forked one creates its own."""
    global _thread
    with _starting:
        if _thread is None or _thread.process != os.getpid():
            _thread = _SolverThread()
            _thread.start()
        return _thread


def _abandon(thread: _SolverThread) -> None:
    """Abandon a thread, so that the next solver gets a new one."""
    global _thread, _num_left
    with _starting:
        thread.is_abandoned = True
        _num_left += 1
        if _thread is thread:
            _thread = None


def has_abandoned_solver() -> bool:
    """Return whether a solver may still run: then the process must not wait for its libraries."""
    return _num_left > 0


class Deadline(ca.Callback):
    """Callback that stops IPOPT between two iterations once the clock passes `at`."""

    def __init__(self, variables: int, rows: int, parameters: int) -> None:
        """Create the callback for a program with some variables, rows and parameters."""
        ca.Callback.__init__(self)
        self.time_limit = float("inf")  # time of `time.monotonic` [s]
        sizes = {"x": variables, "f": 1, "g": rows, "p": parameters}
        self._sizes = sizes | {f"lam_{name}": size for name, size in sizes.items()}
        self.construct("deadline", {})

    def get_n_in(self) -> int:
        """Return the number of inputs, which is that of nlpsol's outputs."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return the number of outputs, one flag."""
        return 1

    def get_sparsity_in(self, index: int) -> Any:
        """Return the shape of an input."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(index)], 1)

    def stop(self) -> None:
        """Stop at the next iteration."""
        self.time_limit = -float("inf")

    def eval(self, _: Any) -> list[int]:
        """Return 1 to stop."""
        return [int(time.monotonic() > self.time_limit)]
