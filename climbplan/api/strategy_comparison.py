"""Compare a trained strategy with the default method on new problems, and say which to use.

Each problem is solved by both, one after the other on this machine. Where no candidate of the
strategy leads to an answer, the default method answers, so that its time is added: this is what a
user of the strategy waits for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.api.solving import Solution, solve
from climbplan.errors import UsageError
from climbplan.program.problem import Problem

COST_TOLERANCE = 0.01  # relative, of a cost that counts as the same
_MIN_SPEEDUP = 1.2  # from which a strategy is worth its data


@dataclass(frozen=True)
class ComparedProblem:
    """One problem solved by both; costs are None without an answer."""

    default_seconds: float
    default_cost: float | None
    strategy_seconds: float  # until its own answer, or until it had none
    strategy_cost: float | None

    @property
    def seconds_with_fallback(self) -> float:
        """Time until an answer with the strategy first [s]."""
        fallback = self.default_seconds if self.strategy_cost is None else 0.0
        return self.strategy_seconds + fallback

    @property
    def cost_ratio(self) -> float:
        """Cost by the strategy over that by the default method; NaN without both."""
        if self.strategy_cost is None or self.default_cost is None:
            return float("nan")
        scale = max(abs(self.default_cost), 1e-9)
        return 1.0 + (self.strategy_cost - self.default_cost) / scale


@dataclass(frozen=True)
class StrategyComparison:
    """All compared problems."""

    kind: str  # of the strategy, which is the name of its method
    default_method: str
    problems: tuple[ComparedProblem, ...]

    @property
    def speedup(self) -> float:
        """Ratio of the median times, above 1 where the strategy is faster."""
        default = np.median([problem.default_seconds for problem in self.problems])
        strategy = np.median([problem.seconds_with_fallback for problem in self.problems])
        return float(default / max(strategy, 1e-9))

    @property
    def worst_cost_ratio(self) -> float:
        """The largest cost ratio; NaN if the strategy answered nothing that can be compared."""
        ratios = [problem.cost_ratio for problem in self.problems]
        finite_ratios = [ratio for ratio in ratios if np.isfinite(ratio)]
        return max(finite_ratios, default=float("nan"))

    @property
    def pays(self) -> bool:
        """Return whether the strategy is faster at the same cost."""
        return self.speedup >= _MIN_SPEEDUP and self.worst_cost_ratio <= 1.0 + COST_TOLERANCE

    @property
    def verdict(self) -> str:
        """Return which method to use, and why."""
        answered = sum(problem.strategy_cost is not None for problem in self.problems)
        facts = f"{answered} of {len(self.problems)} problems answered by {self.kind}"
        if answered:
            facts += f", cost at most {self.worst_cost_ratio:.3f} times as high"
        if self.pays:
            return f"use {self.kind}: {self.speedup:.1f} times as fast; {facts}; it proves no bound"
        speed = f"{1.0 / self.speedup:.1f} times as slow"
        if self.speedup > 1.0:
            speed = f"only {self.speedup:.1f} times as fast"
        return f"use {self.default_method}: {self.kind} is {speed}; {facts}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for reports."""
        ratio = self.worst_cost_ratio
        return {
            "default_method": self.default_method,
            "problems": len(self.problems),
            "answered": sum(problem.strategy_cost is not None for problem in self.problems),
            "default_seconds": float(np.median([p.default_seconds for p in self.problems])),
            "strategy_seconds": float(np.median([p.seconds_with_fallback for p in self.problems])),
            "worst_cost_ratio": ratio if np.isfinite(ratio) else None,
            "pays": self.pays,
            "verdict": self.verdict,
        }


def compare_strategy(
    problem: Problem,
    model: Path,
    kind: str,
    count: int,
    *,
    default_method: str = "auto",
    seed: int = 0,
    time_limit: float = 60.0,
    report: Callable[[float], None] = lambda fraction: None,
) -> StrategyComparison:
    """Solve new problems by the default method and by a strategy.

    Args:
        problem: the problem, with a sampler.
        model: file of the strategy.
        kind: kind of its model, such as "forest".
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
    compared = []
    for number in range(count + 1):
        theta = problem.sample(rng)

        def answer(method: str, theta: Any = theta, **settings: Any) -> tuple[float, float | None]:
            begin = time.perf_counter()
            solution: Solution = solve(
                problem, theta, method=method, time_limit=time_limit, **settings
            )
            return time.perf_counter() - begin, solution.objective

        compared.append(
            ComparedProblem(*answer(default_method), *answer(kind, model=model, fallback=None))
        )
        report((number + 1) / (count + 1))
    return StrategyComparison(kind, default_method, tuple(compared[1:]))
