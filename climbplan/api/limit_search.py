"""Bracket and bisection over one number: which value to try next, from what was tried so far.

A value passes or fails. The search assumes that values on one side of a threshold pass and those
on the other fail. It doubles (or halves) a value until the outcome changes, then bisects:

    find the last x that passes on the way to the harder end, to a tolerance on x.

Where the assumption does not hold, the search still ends with a value that passes next to one that
fails; other values may then pass beyond it.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Literal

Direction = Literal["largest", "smallest"]
"""Which value that passes is sought: larger ones are harder, or smaller ones are."""

Proposals = Generator[float, bool, None]
"""Yields the values to try; is sent whether the last one passed."""

_MAX_HARDER, _MAX_EASIER = 20, 8  # values tried before one is bracketed
_DIGITS = 6  # significant digits of values between two others
_WIDE_RATIO = 4.0  # from which the geometric mean halves an interval better


@dataclass(frozen=True)
class Bound:
    """An end of the range of a number; an open one is not in the range itself."""

    value: float
    is_closed: bool = True


@dataclass(frozen=True)
class Tolerance:
    """Largest distance of a value that passes from one that fails, at the end of a search.

    Attributes:
        width: their distance, in the unit of the values, or as a fraction of the larger one.
        is_relative: whether `width` is such a fraction.
    """

    width: float
    is_relative: bool

    def is_met(self, first: float, second: float, scale: float) -> bool:
        """Return whether two values are close enough; a fraction refers to `scale` at least."""
        reference = max(abs(first), abs(second), scale) if self.is_relative else 1.0
        return abs(second - first) <= self.width * reference * (1 + 1e-9)


@dataclass(frozen=True)
class Domain:
    """The range of the number, and where the search starts.

    Attributes:
        start: the first value.
        lower: the lower end.
        upper: the upper end.
        first_step: the step from a start at zero, which cannot be doubled.
        is_integer: whether the number is a count.
    """

    start: float
    lower: Bound
    upper: Bound
    first_step: float
    is_integer: bool = False

    @property
    def scale(self) -> float:
        """The size of values near zero that a relative tolerance refers to."""
        return 0.1 * abs(self.start) or self.first_step

    def walk(self, sign: int, count: int) -> Iterator[float]:
        """Yield values from the start upwards (`sign` 1) or downwards (-1), up to the end.

        Values double, or halve on the way to an end that is not beyond zero. An open end is
        approached by halving the distance from it.

        Args:
            sign: 1 upwards, -1 downwards.
            count: number of values, without a closed end, which is yielded last.
        """
        end = self.upper if sign > 0 else self.lower
        value = self.start
        for _ in range(count):
            following = self._step(value, sign, end)
            if sign * (following - end.value) >= 0 or following == value:
                break
            value = following
            yield value
        if end.is_closed and math.isfinite(end.value) and value != end.value:
            yield end.value

    def _step(self, value: float, sign: int, end: Bound) -> float:
        if sign * value < 0 and sign * end.value <= 0:  # towards zero, and not beyond
            following = value / 2
        else:
            following = value + sign * max(abs(value), self.first_step)
        if not end.is_closed and sign * (following - end.value) >= 0:
            following = self.halve(value, end.value)
        return float(math.trunc(following)) if self.is_integer else following

    def halve(self, first: float, second: float) -> float:
        """Return a value between two others, with few digits; the first where there is none."""
        low, high = min(first, second), max(first, second)
        if self.is_integer:
            return first if high - low < 2 else math.floor((low + high) / 2)
        middle = math.sqrt(low * high) if low > 0 and high > _WIDE_RATIO * low else (low + high) / 2
        short = float(f"{middle:.{_DIGITS}g}")
        middle = short if low < short < high else middle
        return middle if low < middle < high else first


def propose_values(domain: Domain, direction: Direction, tolerance: Tolerance) -> Proposals:
    """Yield the values to try in a search whose harder end is known.

    Args:
        domain: range and start.
        direction: "largest" where larger values are harder, "smallest" where smaller ones are.
        tolerance: distance of the last value that passes and the first that fails.
    """
    sign = 1 if direction == "largest" else -1
    best: float | None = None
    failed: float | None = None
    if (yield domain.start):
        best = domain.start
        for value in domain.walk(sign, _MAX_HARDER):
            if not (yield value):
                failed = value
                break
            best = value
    else:
        failed = domain.start
        for value in domain.walk(-sign, _MAX_EASIER):
            if (yield value):
                best = value
                break
            failed = value
    if best is not None and failed is not None:
        yield from _bisect(domain, tolerance, best, failed)


def propose_between_ends(domain: Domain, tolerance: Tolerance) -> Proposals:
    """Yield the values to try where neither end is known to be the harder one.

    The start, then both ends, which must be closed. If both ends fail and the start passes, the
    search goes on upwards.
    """
    start, lower, upper = domain.start, domain.lower.value, domain.upper.value
    passes = {start: (yield start)}
    for end in (lower, upper):
        if end not in passes:
            passes[end] = yield end
    if passes[lower] and passes[upper]:
        if not passes[start]:
            yield from _bisect(domain, tolerance, lower, start)
    elif passes[lower]:
        inner = (start, upper) if passes[start] else (lower, start)
        yield from _bisect(domain, tolerance, *inner)
    elif passes[upper]:
        inner = (start, lower) if passes[start] else (upper, start)
        yield from _bisect(domain, tolerance, *inner)
    elif passes[start]:
        yield from _bisect(domain, tolerance, start, upper)


def _bisect(domain: Domain, tolerance: Tolerance, best: float, failed: float) -> Proposals:
    while not tolerance.is_met(best, failed, domain.scale):
        middle = domain.halve(best, failed)
        if middle == best:  # no number lies between them
            return
        if (yield middle):
            best = middle
        else:
            failed = middle


def guess_direction(outcomes: dict[float, bool]) -> Direction:
    """Return the direction that outcomes by value show: "smallest" if the smallest value failed.

    "largest" where the smallest value passed, or where both ends failed.
    """
    lowest, highest = min(outcomes), max(outcomes)
    return "smallest" if outcomes[highest] and not outcomes[lowest] else "largest"
