"""Compare a trained strategy with the default method on new problems, and say which to use.

Each problem is solved in three ways, one after the other on this machine: by the default method,
by the same method with the integers of the strategy tried first, which keeps the proof of
optimality, and by the strategy alone. Where no candidate of the strategy leads to an answer, the
default method answers, so that its time is added: this is what a user of the strategy waits for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.errors import UsageError
from climbplan.learning.model import StrategyModel
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method, MethodSettings, SharedCache
from climbplan.program.problem import Problem, Theta

COST_TOLERANCE = 0.01  # relative, of a cost that counts as the same
_MIN_SPEEDUP = 1.2  # from which a strategy is worth its data


@dataclass(frozen=True)
class Attempt:
    """One way of solving one problem."""

    seconds: float  # until an answer, the default method's where this way had none
    cpu_seconds: float
    cost: float | None  # of its own answer; None without one
    is_proved: bool  # whether the answer is optimal within the gap, with a bound


@dataclass(frozen=True)
class ComparedProblem:
    """One problem solved in three ways."""

    default: Attempt
    proposed: Attempt  # the default method, which tries the strategy's integers first
    alone: Attempt  # the strategy's integers only


@dataclass(frozen=True)
class WaySummary:
    """One way of solving all problems, in relation to the default method."""

    speedup: float  # ratio of the median times, above 1 where it is faster than the default
    seconds: float  # median
    cpu_seconds: float  # median
    answered: int  # problems that it answered itself
    proved: int  # problems that it answered with a proof
    worst_cost_ratio: float  # largest cost over that of the default; NaN if nothing is comparable

    @property
    def pays(self) -> bool:
        """Return whether it is faster at the same cost."""
        return self.speedup >= _MIN_SPEEDUP and self.worst_cost_ratio <= 1.0 + COST_TOLERANCE

    @property
    def speed(self) -> str:
        """Return the speed in words."""
        if self.speedup >= _MIN_SPEEDUP:
            return f"{self.speedup:.1f} times as fast"
        if self.speedup > 1.0:
            return f"only {self.speedup:.1f} times as fast"
        return f"{1.0 / self.speedup:.1f} times as slow"


@dataclass(frozen=True)
class StrategyComparison:
    """All compared problems."""

    kind: str  # of the strategy, which is the name of its method
    default_method: str
    problems: tuple[ComparedProblem, ...]

    def summarise(self, approach: str) -> WaySummary:
        """Return the summary of an approach: "default", "proposed" or "alone"."""
        attempts: list[Attempt] = [getattr(problem, approach) for problem in self.problems]
        ratios = [
            _compute_cost_ratio(getattr(problem, approach).cost, problem.default.cost)
            for problem in self.problems
        ]
        default_seconds = np.median([problem.default.seconds for problem in self.problems])
        seconds = float(np.median([attempt.seconds for attempt in attempts]))
        return WaySummary(
            speedup=float(default_seconds / max(seconds, 1e-9)),
            seconds=seconds,
            cpu_seconds=float(np.median([attempt.cpu_seconds for attempt in attempts])),
            answered=sum(attempt.cost is not None for attempt in attempts),
            proved=sum(attempt.is_proved for attempt in attempts),
            worst_cost_ratio=max((r for r in ratios if np.isfinite(r)), default=float("nan")),
        )

    @property
    def pays(self) -> bool:
        """Return whether the strategy is faster at the same cost, with a proof or without."""
        return self.summarise("proposed").pays or self.summarise("alone").pays

    @property
    def verdict(self) -> str:
        """Return which method to use, and why."""
        proposed, alone = self.summarise("proposed"), self.summarise("alone")
        facts = f"{alone.answered} of {len(self.problems)} problems answered"
        if alone.answered:
            facts += f", cost at most {alone.worst_cost_ratio:.3f} times as high"
        by_itself = f"method {self.kind}, without a proof, is {alone.speed}; {facts}"
        if proposed.pays:
            return (
                f"use the model with method {self.default_method}, which tries its integers "
                f"first: {proposed.speed} with the same proof; {by_itself}"
            )
        if alone.pays:
            return f"use {self.kind}: {alone.speed}; {facts}; it proves no optimum"
        return (
            f"use {self.default_method} without the model: with its integers first it is "
            f"{proposed.speed}; {by_itself}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for reports."""
        default = self.summarise("default")
        values: dict[str, Any] = {
            "default_method": self.default_method,
            "problems": len(self.problems),
            "default_seconds": default.seconds,
        }
        for approach, name in (("proposed", "integers_first"), ("alone", "strategy")):
            summary = self.summarise(approach)
            ratio = summary.worst_cost_ratio
            values[f"{name}_seconds"] = summary.seconds
            values[f"{name}_answered"] = summary.answered
            values[f"{name}_proved"] = summary.proved
            values[f"{name}_worst_cost_ratio"] = ratio if np.isfinite(ratio) else None
        return {**values, "pays": self.pays, "verdict": self.verdict}


def _compute_cost_ratio(cost: float | None, default_cost: float | None) -> float:
    """Return a cost over that of the default method; NaN without both."""
    if cost is None or default_cost is None:
        return float("nan")
    return 1.0 + (cost - default_cost) / max(abs(default_cost), 1e-9)


def compare_strategy(
    problem: Problem,
    model: StrategyModel,
    count: int,
    *,
    default_method: Method = "auto",
    seed: int = 0,
    time_limit: float = 60.0,
    report: Callable[[float], None] = lambda fraction: None,
) -> StrategyComparison:
    """Solve new problems by the default method and by a strategy.

    Args:
        problem: the problem, with a sampler.
        model: the strategy.
        count: number of problems; one more is solved first and does not count, as it compiles.
        default_method: name of the method to compare with.
        seed: of the problems.
        time_limit: of each answer [s].
        report: called with the fraction that is done.

    Raises:
        UsageError: the problem has no sampler.
    """
    if problem.sample is None:
        raise UsageError(f"problem {problem.name!r} has no sampler, which draws new problems")
    rng = np.random.default_rng(seed)
    unaided = MethodSettings(time_limit=time_limit)
    learned = MethodSettings(time_limit=time_limit, model=model, fallback=None)
    proposed_cache, alone_cache = SharedCache(), SharedCache()
    compared = []
    for number in range(count + 1):
        theta = problem.sample_parameters(rng)
        default = _attempt(problem, theta, default_method, unaided, SharedCache())
        proposed = _attempt(problem, theta, default_method, learned, proposed_cache)
        alone = _attempt(problem, theta, model.kind, learned, alone_cache)
        compared.append(
            ComparedProblem(
                default, _add_fallback(proposed, default), _add_fallback(alone, default)
            )
        )
        report((number + 1) / (count + 1))
    return StrategyComparison(model.kind, default_method, tuple(compared[1:]))


def _attempt(
    problem: Problem, theta: Theta, method: Method, settings: MethodSettings, cache: SharedCache
) -> Attempt:
    """Solve a problem by one method."""
    begin, cpu_begin = time.perf_counter(), time.process_time()
    result = solve_instance(problem, theta, method, settings, cache).result
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
    return Attempt(seconds, cpu_seconds, result.objective, result.status == "optimal")


def _add_fallback(attempt: Attempt, default: Attempt) -> Attempt:
    """Return an attempt with the time of the default method, if it has no answer itself."""
    if attempt.cost is not None:
        return attempt
    return Attempt(
        attempt.seconds + default.seconds, attempt.cpu_seconds + default.cpu_seconds, None, False
    )
