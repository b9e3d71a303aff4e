"""How far long runs are: stages, fractions, incumbents and bounds, and lines that say so.

Planners call a `Progress` with the stage and its fraction. Searches that know an incumbent or a
bound call `report_search` and compilers `report_compilation`. Both reach the `ProgressMeter` that
observes the run in this context. Without one they do nothing, as in worker processes.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from types import TracebackType
from typing import Self

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share of it that is done, from 0 to 1."""

AFTER_SEARCH = "verify"  # stage that no time limit of a search ends
LINE_INTERVAL = 5.0  # [s] between lines of progress
INTERVAL_VARIABLE = "CLIMBPLAN_PROGRESS_SECONDS"  # of the environment, for `LINE_INTERVAL`
_MIN_FRACTION = 0.03  # of a stage, from which its remaining time is estimated
_METER: ContextVar[ProgressMeter | None] = ContextVar("meter", default=None)


@dataclass(frozen=True)
class SearchStatus:
    """Figures of a search: cost of the best solution, lower bound, and end of its time."""

    incumbent: float | None = None
    bound: float | None = None
    deadline: float | None = None  # [s] of `time.monotonic`


def report_search(
    incumbent: float | None = None, bound: float | None = None, deadline: float | None = None
) -> None:
    """Report what a search has found to the meter that observes the run, if there is one.

    Args:
        incumbent: Cost of the best solution so far; None or infinity means that there is none.
        bound: Lower bound on the cost; None or minus infinity means that there is none.
        deadline: Time of `time.monotonic` [s] at which the search ends; None keeps the last one.
    """
    meter = _METER.get()
    if meter is not None:
        meter.report_search(incumbent, bound, deadline)


def report_stage(stage: str, fraction: float) -> None:
    """Report the fraction of a stage that a solver has to the meter, if there is one."""
    meter = _METER.get()
    if meter is not None:
        meter.report(stage, fraction)


def is_observed() -> bool:
    """Return whether a meter observes the run in this context."""
    return _METER.get() is not None


@contextmanager
def hide_searches() -> Iterator[None]:
    """Report nothing of searches for subproblems, whose figures are not those of the problem."""
    token = _METER.set(None)
    try:
        yield
    finally:
        _METER.reset(token)


def report_compilation(function: str) -> None:
    """Report that a function is being compiled, "" that the compilation ended."""
    meter = _METER.get()
    if meter is not None:
        meter.report_compilation(function)


class ProgressMeter:
    """The latest figures of a run: stage, fraction, search and compilation."""

    def __init__(self) -> None:
        self.stage = ""
        self.fraction = 0.0  # of the stage
        self.search = SearchStatus()
        self.num_compiled = 0  # functions
        self.compilation_seconds = 0.0  # of those that are complete
        self._started = self._stage_started = time.monotonic()
        self._compiling = ""  # function, "" if none
        self._compilation_started = 0.0  # [s] monotonic

    @contextmanager
    def observe(self) -> Iterator[Self]:
        """Receive what `report_search` and `report_compilation` report in this context."""
        token = _METER.set(self)
        try:
            yield self
        finally:
            _METER.reset(token)

    def report(self, stage: str, fraction: float) -> None:
        """Record the fraction of a stage.

        A new stage forgets the search of the last one, and the verification its deadline.
        """
        if stage != self.stage:
            is_after_search = stage.rpartition(": ")[2] == AFTER_SEARCH  # "2 kg: verify" of limits
            deadline = None if is_after_search else self.search.deadline
            self.stage, self.search = stage, SearchStatus(deadline=deadline)
            self._stage_started = time.monotonic()
        self.fraction = fraction

    def report_search(
        self, incumbent: float | None, bound: float | None, deadline: float | None
    ) -> None:
        """Record the figures of a search, as the function of this name."""
        self.search = SearchStatus(
            _keep_finite(incumbent),
            _keep_finite(bound),
            self.search.deadline if deadline is None else deadline,
        )

    def report_compilation(self, function: str) -> None:
        """Record that a function is being compiled, "" that the compilation ended."""
        now = time.monotonic()
        if function:
            self._compilation_started = now
        elif self._compiling:
            self.num_compiled += 1
            self.compilation_seconds += now - self._compilation_started
        self._compiling = function

    @property
    def elapsed(self) -> float:
        """Time since the meter began [s]."""
        return time.monotonic() - self._started

    @property
    def remaining(self) -> float | None:
        """Estimate of the time that the stage still takes [s]; None where nothing is known."""
        if not _MIN_FRACTION <= self.fraction < 1.0:
            return None
        return (time.monotonic() - self._stage_started) * (1.0 / self.fraction - 1.0)

    def describe(self) -> str:
        """Return one line: stage, fraction, and the facts of `describe_facts`."""
        percent = f"{100 * self.fraction:.0f} %" if self.fraction > 0 else ""
        return f"{self.stage or 'prepare':<9} {percent:<6}{self.describe_facts()}"

    def describe_facts(self) -> str:
        """Return times, incumbent and bound, and what is being compiled, as far as known."""
        facts = [f"{format_seconds(self.elapsed)} elapsed", self._describe_time_left()]
        if self.search.incumbent is not None:
            facts.append(f"incumbent {self.search.incumbent:.4g}")
        if self.search.bound is not None:
            facts.append(f"bound {self.search.bound:.4g}")
        if self._compiling:
            seconds = self.compilation_seconds + time.monotonic() - self._compilation_started
            facts.append(
                f"compiling {self._compiling} (number {self.num_compiled + 1}, "
                f"{format_seconds(seconds)} so far)"
            )
        return ", ".join(filter(None, facts))

    def _describe_time_left(self) -> str:
        remaining, deadline = self.remaining, self.search.deadline
        at_most = math.inf if deadline is None else max(deadline - time.monotonic(), 0.0)
        if remaining is not None and remaining <= at_most:
            return f"about {format_seconds(remaining)} left of this stage"
        return f"at most {format_seconds(at_most)} left" if math.isfinite(at_most) else ""


class ProgressLines:
    """Context in which a line of a meter is written every few seconds, by a thread."""

    def __init__(
        self,
        meter: ProgressMeter,
        write: Callable[[str], None],
        interval: float | None = None,
    ) -> None:
        """Name the meter, what writes a line, and the time between lines [s].

        Without an interval it is that of the environment, or `LINE_INTERVAL`.

        Raises:
            ValueError: That of the environment is no positive number.
        """
        if interval is None:
            interval = _read_interval()
        self._meter, self._write, self._interval = meter, write, interval
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(self._interval):
            self._write(self._meter.describe())


def _read_interval() -> float:
    """Return the time between lines [s] that the environment sets, or `LINE_INTERVAL`.

    Raises:
        ValueError: The environment sets none.
    """
    text = os.environ.get(INTERVAL_VARIABLE)
    try:
        seconds = LINE_INTERVAL if text is None else float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds < math.inf:
        raise ValueError(
            f"environment variable {INTERVAL_VARIABLE}: expected a positive number of seconds "
            f"between lines of progress, got {text!r}; change or unset it"
        )
    return seconds


def format_seconds(seconds: float) -> str:
    """Return a duration [s] for people: "8 s", "2:05 min", "1:02:05 h"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d} h"


def _keep_finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
