"""Local sequential quadratic programming (SQP) on programs with fixed integers.

This solves the online problem of X. Lin (UCLA 2022, chapter 7.2.2.2): linearise the products about
the current iterate, solve a convex quadratic program in a trust region, repeat (Nocedal and Wright,
chapter 18). Where linearised rows contradict, an elastic step minimises their largest violation. A
candidate for which the violation does not shrink is dropped. The answer is local, and its
feasibility is computed from the exact instance.
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
from climbplan.solvers.sqp.step import (
    QuadraticProgram,
    Step,
    StepSolver,
    create_step_solver,
    project_to_convex,
)

_STALL_FRACTION = 0.9  # remaining fraction of the violation above which a candidate is dropped
_ACCEPTED_FRACTION = 0.3  # remaining fraction of the violation below which a step is accepted
_EARLY_CUTOFF_MARGIN = 0.01  # margin of the early cutoff, as a fraction of the start's cost
_UNIT_COST = 1e-3  # smallest scale of the cost

Ending = Literal["converged", "contradiction", "stalled", "cutoff", "steps", "failed"]


@dataclass(frozen=True)
class SqpOptions:
    """Stopping criteria and step sizes of SQP."""

    backend: ConvexBackend = "daqp"
    steps: int = 30  # largest number of quadratic programs
    tolerance: float = 1e-7  # of rows, relative to their range over the variables' scale
    still: float = 1e-6  # step length at which the method stops, in the variables' scale
    gain: float = 1e-7  # relative decrease of the cost at which the method stops
    radius: float = 0.5  # initial trust-region radius of factors, in their scale
    proximal: float = 1e-4  # proximal weight, relative to the largest curvature
    curvature: bool = True  # whether to add the convex part of the Lagrangian's Hessian
    restorations: int = 8  # largest number of restoration steps
    hasty: float = 2.0  # a linearised optimum this many times the cutoff ends a search


@dataclass(frozen=True)
class SqpResult:
    """The result of one local search."""

    x: Array | None  # (n,) last iterate; None where rows contradict before the first step
    ending: Ending
    violation: float  # of rows with products, relative to their range
    objective: float
    programs: int  # quadratic programs solved
    seconds: float

    @property
    def feasible(self) -> bool:
        """Return whether all rows of the model hold to the method's tolerance."""
        return self.ending in ("converged", "steps")


class SqpSolver:
    """Solves candidates of one instance one after the other, from given starts."""

    def __init__(self, instance: Instance, options: SqpOptions | None = None) -> None:
        """Build the dense form.

        Raises:
            UsageError: The instance has smooth rows or is too large.
        """
        self.options = options or SqpOptions()
        if instance.smooth is not None:
            raise UsageError(f"{instance.name}: local SQP cannot hold smooth rows; use ipopt")
        self.form = SqpForm.build(instance)
        self._steps = create_step_solver(self.options.backend)
        self._models: dict[bytes, ReducedModel | None] = {}  # of the integers seen so far

    def solve(
        self, values: Array, alternatives: IntArray, start: Array, cutoff: float = np.inf
    ) -> SqpResult:
        """Find a local optimum at the integers of values (n,) from a start (n,).

        Args:
            values: (n,) point whose integers are fixed.
            alternatives: (C,) alternative of each choice.
            start: (n,) start.
            cutoff: Cost of a feasible linearisation above which the search ends.
        """
        begin = time.perf_counter()
        integer = self.form.fixed_form.source.integer
        key = (values[integer] > 0.5).tobytes() + np.asarray(alternatives, np.int64).tobytes()
        if key not in self._models:
            self._models[key] = self.form.fix_integers(values, alternatives)
        model = self._models[key]
        if model is None:
            return SqpResult(None, "contradiction", np.inf, np.inf, 0, time.perf_counter() - begin)
        y = np.clip(start[model.independent], model.low, model.high)
        run = _SqpRun(model, self.options, self._steps, cutoff, y)
        ending = run.iterate()
        return SqpResult(
            x=model.recover_point(run.y),
            ending=ending,
            violation=run.violation,
            objective=model.objective(run.y),
            programs=run.programs,
            seconds=time.perf_counter() - begin,
        )


@dataclass(frozen=True)
class _TrialPoint:
    """A trial point of a step."""

    y: Array
    values: Array  # of the curves
    violation: float
    cost: float


class _SqpRun:
    """The state of one local search."""

    def __init__(
        self, model: ReducedModel, options: SqpOptions, steps: StepSolver, cutoff: float, y: Array
    ) -> None:
        """Begin at a point."""
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
        self.multipliers = np.zeros(model.nonlinear_rows.count)
        self.curved = np.flatnonzero(model.is_nonlinear)

    def iterate(self) -> Ending:
        """Iterate until convergence or a limit."""
        options = self.options
        if not self._project_to_linear_rows():
            return "contradiction"
        self._scale_nonlinear_rows()
        model, curves = self.model, self.model.nonlinear_rows
        row_values = curves.evaluate(self.y)
        self.violation = _compute_max_violation(self.low, self.high, row_values)
        radius, num_restorations = options.radius, 0
        initial_cost = abs(model.objective(self.y))
        while self.programs < options.steps:
            slopes = curves.compute_jacobian(self.y)
            step = self._solve_step(slopes, radius, row_values)
            restoring = step.d is None
            if restoring:
                if self.violation <= options.tolerance:
                    return "converged"  # rounding: the point itself satisfies the rows
                num_restorations += 1
                if num_restorations > options.restorations:
                    return "stalled"
                step = self._solve_restoration(row_values, slopes, radius)
            if step.d is None:
                return "failed"
            length = self._measure_step(step.d)
            if restoring:
                linearised = row_values + slopes @ step.d
                remaining = _compute_max_violation(self.low, self.high, linearised)
                if remaining > _STALL_FRACTION * self.violation and length < 0.9 * radius:
                    return "contradiction"
            else:
                self.penalty = max(self.penalty, 2.0 * float(np.abs(step.multipliers).sum()))
            trial = self._evaluate_trial(step.d)
            limit = self.cutoff + (options.hasty - 1) * abs(self.cutoff)
            limit += _EARLY_CUTOFF_MARGIN * initial_cost
            if not restoring and length < 0.99 * radius and trial.cost > limit:
                return "cutoff"
            if not self._is_accepted(trial, restoring) and not restoring:
                step, trial = self._correct_step(step.d, slopes, radius) or (step, trial)
            is_converged = length <= options.still
            if not self._is_accepted(trial, restoring) and not is_converged:
                radius = min(radius, length) / 4
                if radius < options.still:
                    return "converged" if self.violation <= options.tolerance else "stalled"
                continue
            cost = model.objective(self.y)
            progress = abs(cost - trial.cost)
            self.y, row_values, self.violation = trial.y, trial.values, trial.violation
            self.multipliers = step.multipliers
            if length > 0.8 * radius:
                radius *= 2.0
            if restoring or trial.violation > options.tolerance:
                if is_converged:
                    return "stalled"
                continue
            if trial.cost - progress > self.cutoff:
                return "cutoff"
            min_decrease = options.gain * (_UNIT_COST + abs(cost))
            if is_converged or progress <= min_decrease:
                return "converged"
        return "steps" if self.violation <= options.tolerance else "stalled"

    def _scale_nonlinear_rows(self) -> None:
        """Scale the nonlinear rows by their largest change over the scale of a variable."""
        curves = self.model.nonlinear_rows
        reach = np.abs(curves.compute_jacobian(self.y)) * self.scale
        curves = curves.scale(reach.max(axis=1, initial=1e-6))
        self.model = replace(self.model, nonlinear_rows=curves)
        self.low, self.high = curves.bounds

    def _correct_step(
        self, d: Array, slopes: Array, radius: float
    ) -> tuple[Step, _TrialPoint] | None:
        """Return the second-order correction of a step d, None if its trial is not accepted.

        It has the same Jacobian, and the exact values at the step's trial point.
        """
        corrected_values = self.model.nonlinear_rows.evaluate(self.y + d) - slopes @ d
        step = self._solve_step(slopes, radius, corrected_values)
        if step.d is None:
            return None
        trial = self._evaluate_trial(step.d)
        return (step, trial) if self._is_accepted(trial, False) else None

    def _evaluate_trial(self, d: Array) -> _TrialPoint:
        """Evaluate a trial point."""
        y = np.clip(self.y + d, self.model.low, self.model.high)
        values = self.model.nonlinear_rows.evaluate(y)
        return _TrialPoint(
            y, values, _compute_max_violation(self.low, self.high, values), self.model.objective(y)
        )

    def _is_accepted(self, trial: _TrialPoint, restoring: bool) -> bool:
        """Return whether the merit function falls, or the violation falls a lot.

        The merit function is cost + penalty * violation.
        """
        if restoring:
            return trial.violation < self.violation * (1 - 1e-3)
        tolerance = self.options.tolerance
        if trial.violation <= max(_ACCEPTED_FRACTION * self.violation, tolerance) < self.violation:
            return True
        cost = self.model.objective(self.y)
        # Violations below the tolerance do not count, or rounding would decide.
        fall = max(self.violation, tolerance) - max(trial.violation, tolerance)
        return cost - trial.cost + self.penalty * fall >= -1e-10 * (1 + abs(cost))

    def _measure_step(self, d: Array) -> float:
        """Return the length of a step over factors, in their scale."""
        return float(np.abs(d / self.scale)[self.model.is_nonlinear].max(initial=0.0))

    def _project_to_linear_rows(self) -> bool:
        """Move the start to the nearest point that satisfies all linear rows, if one exists."""
        model = self.model
        if not len(model.L):
            return True
        rows = model.L @ self.y
        if (rows >= model.lower - 1e-9).all() and (rows <= model.upper + 1e-9).all():
            return True
        r = len(self.y)
        step = self._solve_scaled(
            QuadraticProgram(
                np.eye(r), np.zeros(r), model.low - self.y, model.high - self.y,
                model.L, model.lower - rows, model.upper - rows,
            )
        )  # fmt: skip
        if step.d is None:
            return False
        self.y = np.clip(self.y + step.d, model.low, model.high)
        return True

    def _solve_step(self, slopes: Array, radius: float, about: Array) -> Step:
        """Solve the quadratic program with nonlinear rows about + slopes d."""
        model = self.model
        H = model.P.copy()
        if self.options.curvature and self.multipliers.any():
            block = np.ix_(self.curved, self.curved)
            hessian = model.nonlinear_rows.compute_hessian(self.multipliers)[block]
            H[block] += project_to_convex(hessian, self.scale[self.curved])
        H = H * self.scale[:, None] * self.scale / self.weight
        H[np.diag_indices_from(H)] += self.options.proximal
        f = (model.P @ self.y + model.q) * self.scale / self.weight
        low, high = self._compute_trust_region(radius)
        rows = model.L @ self.y
        step = self._solve_scaled(
            QuadraticProgram(
                H, f, low, high,
                np.vstack([model.L, slopes]),
                np.concatenate([model.lower - rows, self.low - about]),
                np.concatenate([model.upper - rows, self.high - about]),
            )
        )  # fmt: skip
        return Step(step.d, step.multipliers[len(rows) :] * self.weight, step.infeasible)

    def _solve_restoration(self, values: Array, slopes: Array, radius: float) -> Step:
        """Minimise the largest violation of the linearised rows, then the step (elastic mode)."""
        model = self.model
        r = len(self.y)
        low, high = self._compute_trust_region(radius)
        rows = model.L @ self.y
        lower, upper = self.low - values, self.high - values
        below, above = np.isfinite(lower), np.isfinite(upper)
        elastic = np.ones((int(below.sum()), 1)), np.ones((int(above.sum()), 1))
        G = np.vstack(
            [
                np.hstack([model.L, np.zeros((len(rows), 1))]),
                np.hstack([slopes[below], elastic[0]]),
                np.hstack([slopes[above], -elastic[1]]),
            ]
        )
        violation_scale = max(self.violation, 1e-12)
        scale = np.append(self.scale, violation_scale)
        H = np.diag(np.append(np.full(r, 1e-4), 1e-4))
        f = np.append(np.zeros(r), 1.0)
        quadratic = QuadraticProgram(
            H, f,
            np.append(low / self.scale, 0.0),
            np.append(high / self.scale, np.inf),
            G * scale,
            np.concatenate([model.lower - rows, lower[below], np.full(len(elastic[1]), -np.inf)]),
            np.concatenate([model.upper - rows, np.full(len(elastic[0]), np.inf), upper[above]]),
        )  # fmt: skip
        self.programs += 1
        step = self.steps.solve(quadratic)
        d = None if step.d is None else step.d[:r] * self.scale
        return Step(d, np.zeros(len(lower)), step.infeasible)

    def _compute_trust_region(self, radius: float) -> tuple[Array, Array]:
        """Return bounds of a step."""
        model = self.model
        reach = np.where(model.is_nonlinear, radius * self.scale, np.inf)
        return np.maximum(model.low - self.y, -reach), np.minimum(model.high - self.y, reach)

    def _solve_scaled(self, program: QuadraticProgram) -> Step:
        """Solve a quadratic program whose cost, unlike its rows, is over scaled variables."""
        self.programs += 1
        low, high, G = program.low / self.scale, program.high / self.scale, program.G * self.scale
        step = self.steps.solve(replace(program, low=low, high=high, G=G))
        return step if step.d is None else Step(step.d * self.scale, step.multipliers, False)


def _compute_max_violation(low: Array, high: Array, values: Array) -> float:
    """Return the largest violation."""
    return float(np.maximum(low - values, values - high).max(initial=0.0))
