"""Local sequential quadratic programming on programs whose integers are given.

The online problem of chapter 7.2.2.2: linearise the products about the current point, solve a
convex quadratic program in a trust region, repeat. Where linearised rows contradict, the step
makes their largest violation least; a candidate for which that does not shrink is dropped. The
answer is local and its feasibility is computed from the exact instance.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.convex.sessions import ConvexBackend
from climbplan.solvers.sqp.model import ReducedModel, SqpForm
from climbplan.solvers.sqp.step import Quadratic, Step, StepSolver, convex_part, step_solver

_HOPELESS = 0.9  # share of the violation that linearised rows leave at least
_MUCH = 0.3  # a step that leaves no more than this share of the violation is taken
_HASTE = 0.01  # share of the start's cost by which a hasty limit is higher
_UNIT_COST = 1e-3  # costs below count as this much

Ending = Literal["converged", "contradiction", "stalled", "cutoff", "steps", "failed"]


@dataclass(frozen=True)
class SqpOptions:
    """What stops the method and how far it steps."""

    backend: ConvexBackend = "daqp"
    steps: int = 30  # quadratic programs at most
    tolerance: float = 1e-7  # of rows, relative to how far they range over the variables' scale
    still: float = 1e-6  # a step below this share of the variables' scale is none
    gain: float = 1e-7  # relative: a predicted decrease of the cost below it is none
    radius: float = 0.5  # first trust region of factors, in their scale
    proximal: float = 1e-4  # of the largest curvature
    curvature: bool = True  # of the Lagrangian, its convex part
    restorations: int = 8  # steps that only lessen violations
    hasty: float = 2.0  # a linearised optimum this many times the cutoff ends a search


@dataclass(frozen=True)
class SqpResult:
    """The end of one local search."""

    x: Array | None  # (n,) where it ended; None where rows contradict before the first step
    ending: Ending
    violation: float  # of rows with products, relative to their range
    objective: float
    programs: int  # quadratic programs solved
    seconds: float

    @property
    def feasible(self) -> bool:
        """Whether all rows of the model hold to the method's tolerance."""
        return self.ending in ("converged", "steps")


class SqpSolver:
    """Candidates of one instance after the other, from given starts."""

    def __init__(self, instance: Instance, options: SqpOptions | None = None) -> None:
        self.options = options or SqpOptions()
        if instance.smooth is not None:
            raise UsageError(f"{instance.name}: local SQP cannot hold smooth rows; use ipopt")
        self.form = SqpForm.of(instance)
        self._steps = step_solver(self.options.backend)
        self._models: dict[bytes, ReducedModel | None] = {}  # of the integers seen so far

    def solve(
        self, values: Array, alternatives: IntArray, start: Array, cutoff: float = np.inf
    ) -> SqpResult:
        """A local optimum at the integers of values (n,) from a start (n,).

        alternatives: chosen one of each choice. cutoff: give up once the cost of a feasible
        linearisation is above it.
        """
        begin = time.perf_counter()
        integer = self.form.pinned.source.integer
        key = (values[integer] > 0.5).tobytes() + np.asarray(alternatives, np.int64).tobytes()
        if key not in self._models:
            self._models[key] = self.form.reduced(values, alternatives)
        model = self._models[key]
        if model is None:
            return SqpResult(None, "contradiction", np.inf, np.inf, 0, time.perf_counter() - begin)
        y = np.clip(start[model.chosen], model.low, model.high)
        run = _Run(model, self.options, self._steps, cutoff, y)
        ending = run.iterate()
        return SqpResult(
            x=model.point(run.y),
            ending=ending,
            violation=run.violation,
            objective=model.objective(run.y),
            programs=run.programs,
            seconds=time.perf_counter() - begin,
        )


@dataclass(frozen=True)
class _Trial:
    y: Array
    values: Array  # of the curves
    violation: float
    cost: float


class _Run:
    """The state of one local search."""

    def __init__(
        self, model: ReducedModel, options: SqpOptions, steps: StepSolver, cutoff: float, y: Array
    ) -> None:
        self.model, self.options, self.steps, self.cutoff = model, options, steps, cutoff
        self.programs = 0
        self.y = y
        self.violation = np.inf
        self.penalty = 0.0
        width = model.high - model.low
        self.scale = np.where(
            np.isfinite(width), np.where(width > 0, width / 2, 1.0), np.maximum(np.abs(y), 1.0)
        )
        largest = float(np.abs(np.diag(model.P) * self.scale**2).max(initial=0.0))
        self.weight = largest if largest > 0 else 1.0
        self.multipliers = np.zeros(model.curves.count)
        self.bent = np.flatnonzero(model.factor)

    def iterate(self) -> Ending:
        """Step until nothing changes."""
        model, options = self.model, self.options
        if not self._on_linear_rows():
            return "contradiction"
        reach = np.abs(model.curves.slopes(self.y)) * self.scale
        model = self.model = replace(
            model, curves=model.curves.over(reach.max(axis=1, initial=1e-6))
        )
        self.low, self.high = model.curves.ends
        curves = model.curves
        values = curves.values(self.y)
        self.violation = _worst(self.low, self.high, values)
        radius, restored = options.radius, 0
        first = abs(model.objective(self.y))
        while self.programs < options.steps:
            slopes = curves.slopes(self.y)
            step = self._step(slopes, radius, values)
            restoring = step.d is None
            if restoring:
                if self.violation <= options.tolerance:
                    return "converged"  # rounding: the point itself satisfies the rows
                restored += 1
                if restored > options.restorations:
                    return "stalled"
                step = self._least_violation(values, slopes, radius)
            if step.d is None:
                return "failed"
            length = self._length(step.d)
            if restoring:
                left = _worst(self.low, self.high, values + slopes @ step.d)
                if left > _HOPELESS * self.violation and length < 0.9 * radius:
                    return "contradiction"
            else:
                self.penalty = max(self.penalty, 2.0 * float(np.abs(step.multipliers).sum()))
            trial = self._trial(step.d)
            limit = self.cutoff + (options.hasty - 1) * abs(self.cutoff) + _HASTE * first
            if not restoring and length < 0.99 * radius and trial.cost > limit:
                return "cutoff"
            if not self._better(trial, restoring) and not restoring:
                # Second-order correction: the same slopes, with the curves where they really are.
                bent = curves.values(self.y + step.d) - slopes @ step.d
                again = self._step(slopes, radius, bent)
                if again.d is not None and self._better(self._trial(again.d), False):
                    step, trial = again, self._trial(again.d)
            still = length <= options.still
            if not self._better(trial, restoring) and not still:
                radius = min(radius, length) / 4
                if radius < options.still:
                    return "converged" if self.violation <= options.tolerance else "stalled"
                continue
            cost = model.objective(self.y)
            progress = abs(cost - trial.cost)
            self.y, values, self.violation = trial.y, trial.values, trial.violation
            self.multipliers = step.multipliers
            if length > 0.8 * radius:
                radius *= 2.0
            if restoring or trial.violation > options.tolerance:
                if still:
                    return "stalled"
                continue
            if trial.cost - progress > self.cutoff:
                return "cutoff"
            least = options.gain * (_UNIT_COST + abs(cost))
            if still or progress <= least:
                return "converged"
        return "steps" if self.violation <= options.tolerance else "stalled"

    def _trial(self, d: Array) -> _Trial:
        y = np.clip(self.y + d, self.model.low, self.model.high)
        values = self.model.curves.values(y)
        return _Trial(y, values, _worst(self.low, self.high, values), self.model.objective(y))

    def _better(self, trial: _Trial, restoring: bool) -> bool:
        """Merit cost + penalty * violation falls, or the violation falls much."""
        if restoring:
            return trial.violation < self.violation * (1 - 1e-3)
        tolerance = self.options.tolerance
        if trial.violation <= max(_MUCH * self.violation, tolerance) < self.violation:
            return True
        cost = self.model.objective(self.y)
        # Violations below the tolerance do not count, or rounding would decide.
        fall = max(self.violation, tolerance) - max(trial.violation, tolerance)
        return cost - trial.cost + self.penalty * fall >= -1e-10 * (1 + abs(cost))

    def _length(self, d: Array) -> float:
        return float(np.abs(d / self.scale)[self.model.factor].max(initial=0.0))

    def _on_linear_rows(self) -> bool:
        """Move the start to the nearest point that satisfies all linear rows."""
        model = self.model
        if not len(model.L):
            return True
        rows = model.L @ self.y
        if (rows >= model.lower - 1e-9).all() and (rows <= model.upper + 1e-9).all():
            return True
        r = len(self.y)
        step = self._solve(
            np.eye(r), np.zeros(r), model.low - self.y, model.high - self.y,
            model.L, model.lower - rows, model.upper - rows,
        )  # fmt: skip
        if step.d is None:
            return False
        self.y = np.clip(self.y + step.d, model.low, model.high)
        return True

    def _step(self, slopes: Array, radius: float, about: Array) -> Step:
        """The quadratic program with curves about + slopes d."""
        model = self.model
        H = model.P.copy()
        if self.options.curvature and self.multipliers.any():
            at = np.ix_(self.bent, self.bent)
            curved = model.curves.curvature(self.multipliers)[at]
            H[at] += convex_part(curved, self.scale[self.bent])
        H = H * self.scale[:, None] * self.scale / self.weight
        H[np.diag_indices_from(H)] += self.options.proximal
        f = (model.P @ self.y + model.q) * self.scale / self.weight
        low, high = self._region(radius)
        rows = model.L @ self.y
        step = self._solve(
            H, f, low, high,
            np.vstack([model.L, slopes]),
            np.concatenate([model.lower - rows, self.low - about]),
            np.concatenate([model.upper - rows, self.high - about]),
        )  # fmt: skip
        return Step(step.d, step.multipliers[len(rows) :] * self.weight, step.infeasible)

    def _least_violation(self, values: Array, slopes: Array, radius: float) -> Step:
        """Elastic mode: least largest violation of the linearised rows, then least change."""
        model = self.model
        r = len(self.y)
        low, high = self._region(radius)
        rows = model.L @ self.y
        lower, upper = self.low - values, self.high - values
        below, above = np.isfinite(lower), np.isfinite(upper)
        one = np.ones((int(below.sum()), 1)), np.ones((int(above.sum()), 1))
        G = np.vstack(
            [
                np.hstack([model.L, np.zeros((len(rows), 1))]),
                np.hstack([slopes[below], one[0]]),
                np.hstack([slopes[above], -one[1]]),
            ]
        )
        worst = max(self.violation, 1e-12)
        scale = np.append(self.scale, worst)
        H = np.diag(np.append(np.full(r, 1e-4), 1e-4))
        f = np.append(np.zeros(r), 1.0)
        quadratic = Quadratic(
            H, f,
            np.append(low / self.scale, 0.0),
            np.append(high / self.scale, np.inf),
            G * scale,
            np.concatenate([model.lower - rows, lower[below], np.full(len(one[1]), -np.inf)]),
            np.concatenate([model.upper - rows, np.full(len(one[0]), np.inf), upper[above]]),
        )  # fmt: skip
        self.programs += 1
        step = self.steps.solve(quadratic)
        d = None if step.d is None else step.d[:r] * self.scale
        return Step(d, np.zeros(len(lower)), step.infeasible)

    def _region(self, radius: float) -> tuple[Array, Array]:
        model = self.model
        reach = np.where(model.factor, radius * self.scale, np.inf)
        return np.maximum(model.low - self.y, -reach), np.minimum(model.high - self.y, reach)

    def _solve(
        self, H: Array, f: Array, low: Array, high: Array, G: Array, lower: Array, upper: Array
    ) -> Step:
        """In scaled variables."""
        self.programs += 1
        step = self.steps.solve(
            Quadratic(H, f, low / self.scale, high / self.scale, G * self.scale, lower, upper)
        )
        return step if step.d is None else Step(step.d * self.scale, step.multipliers, False)


def _worst(low: Array, high: Array, values: Array) -> float:
    return float(np.maximum(low - values, values - high).max(initial=0.0))
