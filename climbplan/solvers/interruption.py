"""Stopping a compiled solver: by the clock, by Ctrl-C, and by SIGTERM.

Left alone, CasADi swallows what a signal raises and returns as if the solver had been stopped, and
others do not let Python look at signals before they are through.
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
_LOOK = 0.1  # [s] between looks at signals, and at whether to leave a solver behind
_SOON = 0.005  # [s] between looks about a deadline
_GRACE = 0.1  # [s] for a solver to stop at its deadline
_PATIENCE = 0.5  # [s] with solvers that cannot be stopped
_MUCH_WORK = 20_000  # entries of matrices: tens of milliseconds


@contextmanager
def interruptible(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` on Ctrl-C or SIGTERM, and pass the signal on once the solver has returned.

    Nothing is changed where a signal is not handled in Python, and in threads other than the main
    one, which signals do not reach.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before = {number: handler for number, handler in before.items() if callable(handler)}
    if threading.current_thread() is not threading.main_thread() or not before:
        yield
        return
    received: list[int] = []

    def remember(number: int, _: FrameType | None) -> None:
        received.append(number)
        stop()

    for number in before:
        signal.signal(number, remember)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if received:
        handler = before[signal.Signals(received[0])]
        assert callable(handler)
        handler(received[0], None)  # raises KeyboardInterrupt, or what the program made of it


def run_aside(
    solve: Callable[[], object],
    stop: Callable[[], None],
    patience: float = math.inf,
    deadline: float = math.inf,
) -> bool:
    """Run a solver that lets go of Python in a thread, so that this one sees signals meanwhile.

    Ctrl-C and SIGTERM call `stop`, which must be safe while the solver runs, and are passed on
    once the solver has returned, or after `patience` [s]: then it is left to itself, and nothing
    that it works on may be used again. Raises what `solve` raises.

    deadline: `time.monotonic` [s] at which `stop` is called too, and the solver left to itself if
    it has not returned `_GRACE` later. Returns whether it has returned.
    """
    failed: list[BaseException] = []
    leave_at = math.inf

    def run() -> None:
        try:
            solve()
        except BaseException as error:  # passed on in the thread that waits
            failed.append(error)

    def asked() -> None:
        nonlocal leave_at
        leave_at = time.monotonic() + patience
        stop()

    thread = _solver_thread()
    with interruptible(asked):
        done = thread.begin(run)
        # Never without end: a signal between Python's look at them and the wait would be seen when
        # the solver is through
        has_returned = False
        while not (has_returned := done.wait(min(_LOOK, max(deadline - time.monotonic(), _SOON)))):
            _take_ctrl_c_back()
            if time.monotonic() > deadline:
                deadline = math.inf
                leave_at = min(leave_at, time.monotonic() + _GRACE)
                stop()
            if time.monotonic() > leave_at:
                _leave(thread)
                break
    if failed:
        raise failed[0]
    return has_returned


def _take_ctrl_c_back() -> None:
    """Ctrl-C to Python's handler again: OSQP takes it while it runs, and polishes on regardless."""
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGINT)
        if handler is not None:  # nobody else's than Python's
            signal.signal(signal.SIGINT, handler)


def run_deaf(solve: Callable[[], Answer], work: int) -> Answer:
    """What a solver returns that nothing can stop, as DAQP, Clarabel and OSQP are.

    work: entries of its matrices. Small programs are solved in microseconds, as they stand; larger
    ones aside, so that Ctrl-C and SIGTERM leave them behind after half a second. Raises what
    `solve` raises.
    """
    if work < _MUCH_WORK:
        return solve()
    found: list[Answer] = []
    run_aside(lambda: found.append(solve()), lambda: None, _PATIENCE)
    if not found:
        raise KeyboardInterrupt  # where a program makes nothing of its signals
    return found[0]


class _SolverThread(threading.Thread):
    """The thread of all solvers that run aside, one after the other.

    One for all: SCIP's derivatives (CppAD) give every thread that they see a number for good, and
    crash at the sixty-fifth. A daemon: a solver that does not heed `stop` does not keep a process.
    """

    def __init__(self) -> None:
        super().__init__(name="solver", daemon=True)
        self._jobs: queue.SimpleQueue[tuple[Callable[[], None], threading.Event]]
        self._jobs = queue.SimpleQueue()
        self.process = os.getpid()
        self.left = False  # to a solver that did not stop

    def run(self) -> None:
        """Take jobs until it is left."""
        while not self.left:
            job, done = self._jobs.get()
            try:
                job()
            finally:
                done.set()

    def begin(self, job: Callable[[], None]) -> threading.Event:
        """Run a job that raises nothing; what is set when it is done."""
        done = threading.Event()
        if threading.current_thread() is self:
            job()
            done.set()
        else:
            self._jobs.put((job, done))
        return done


_thread: _SolverThread | None = None
_num_left = 0  # solvers that were left to themselves
_starting = threading.Lock()


def _solver_thread() -> _SolverThread:
    """The thread of this process; a forked one has none yet."""
    global _thread
    with _starting:
        if _thread is None or _thread.process != os.getpid():
            _thread = _SolverThread()
            _thread.start()
        return _thread


def _leave(thread: _SolverThread) -> None:
    """The next solver that runs aside gets a thread of its own."""
    global _thread, _num_left
    with _starting:
        thread.left = True
        _num_left += 1
        if _thread is thread:
            _thread = None


def has_left_solver() -> bool:
    """Return whether a solver may still run: then the process must not wait for its libraries."""
    return _num_left > 0


class Deadline(ca.Callback):
    """Stops IPOPT between two iterations once the clock passes `at`.

    variables, rows, parameters: sizes of the program it watches.
    """

    def __init__(self, variables: int, rows: int, parameters: int) -> None:
        ca.Callback.__init__(self)
        self.at = float("inf")  # [s], time.monotonic
        sizes = {"x": variables, "f": 1, "g": rows, "p": parameters}
        self._sizes = sizes | {f"lam_{name}": size for name, size in sizes.items()}
        self.construct("deadline", {})

    def get_n_in(self) -> int:
        """As many as nlpsol has outputs."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """One flag."""
        return 1

    def get_sparsity_in(self, index: int) -> Any:
        """Shapes of the iterate's parts."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(index)], 1)

    def stop(self) -> None:
        """Stop at the next iteration."""
        self.at = -float("inf")

    def eval(self, _: Any) -> list[int]:
        """1 to stop."""
        return [int(time.monotonic() > self.at)]
