"""One step of SQP: a small dense convex quadratic program by DAQP, Clarabel or OSQP.

Variables are steps in units of their scale. A proximal term makes the Hessian definite, which a
dual active-set method needs; it vanishes where the iteration converges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import daqp
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.instance import Implications, Instance, Products
from climbplan.solvers.convex.sessions import ConvexBackend, create_session

_UNBOUNDED = 1e30
_EQUAL, _INEQUALITY = 5, 0
_ACTIVE = 1e-6  # distance to a bound below which rows and variables are active
_OPTIMAL, _INFEASIBLE = 1, -1
_PRIMAL_TOLERANCES = (1e-8, 1e-6)  # the second where DAQP cycles at the first
_ITERATIONS = 500


@dataclass(frozen=True)
class QuadraticProgram:
    """Minimise 1/2 d'H d + f'd subject to low <= d <= high, lower <= G d <= upper."""

    H: Array  # (r, r) positive definite
    f: Array  # (r,)
    low: Array
    high: Array
    G: Array  # (m, r)
    lower: Array
    upper: Array


@dataclass(frozen=True)
class Step:
    """A solver's answer to a quadratic program."""

    d: Array | None  # (r,)
    multipliers: Array  # (m,) of the rows, positive at their upper ends
    infeasible: bool  # whether the solver reports infeasibility; without a step it failed otherwise


class StepSolver(Protocol):
    """Solves the quadratic programs of all steps."""

    def solve(self, quadratic: QuadraticProgram) -> Step:
        """Solve one quadratic program."""


class DaqpStepSolver:
    """Solves steps with DAQP on dense arrays."""

    def solve(self, quadratic: QuadraticProgram) -> Step:
        """Solve one quadratic program; DAQP itself scales the rows."""
        lower = np.concatenate([quadratic.low, quadratic.lower])
        upper = np.concatenate([quadratic.high, quadratic.upper])
        lower, upper = np.maximum(lower, -_UNBOUNDED), np.minimum(upper, _UNBOUNDED)
        sense = np.where(lower == upper, _EQUAL, _INEQUALITY).astype(np.int32)
        for tolerance in _PRIMAL_TOLERANCES:
            d, _, flag, info = daqp.solve(
                quadratic.H,
                quadratic.f,
                quadratic.G,
                upper,
                lower,
                sense,
                primal_tol=tolerance,
                eps_prox=0.0,
                iter_limit=_ITERATIONS,
            )
            if flag == _OPTIMAL and np.isfinite(d).all():
                return Step(np.array(d), np.array(info["lam"])[len(d) :], False)
            if flag == _INFEASIBLE:
                if info["iterations"]:
                    break
                # Linearly dependent equations fail before the first iteration.
                sense = np.zeros_like(sense)
        return Step(None, np.zeros(len(quadratic.lower)), flag == _INFEASIBLE)


class SessionStepSolver:
    """Solves steps with Clarabel or OSQP through their sessions, which return no multipliers."""

    def __init__(self, backend: ConvexBackend) -> None:
        self._session = create_session(backend)

    def solve(self, quadratic: QuadraticProgram) -> Step:
        """Solve one quadratic program; with the same shapes only coefficients are updated."""
        r, m = len(quadratic.f), len(quadratic.lower)
        no_index = np.zeros(0, np.int64)
        empty = sparse.csr_matrix
        instance = Instance(
            name="step",
            P=sparse.csc_matrix(quadratic.H),
            q=quadratic.f,
            constant=0.0,
            lower=quadratic.low,
            upper=quadratic.high,
            A=sparse.csr_matrix(quadratic.G),
            row_lower=quadratic.lower,
            row_upper=quadratic.upper,
            balls=(),
            choices=(),
            integer=np.zeros(r, bool),
            products=Products(no_index, no_index),
            Q=empty((m, 0)),
            implications=Implications(
                empty((0, r)), empty((0, 0)), np.zeros(0), np.zeros(0), no_index, no_index > 0
            ),
        )
        answer = self._session.solve(instance)
        if answer.infeasible or answer.x is None:
            return Step(None, np.zeros(m), answer.infeasible)
        return Step(answer.x, _estimate_multipliers(quadratic, answer.x), False)


def _estimate_multipliers(quadratic: QuadraticProgram, d: Array) -> Array:
    """Estimate multipliers of the rows (m,) by least squares over the active ones."""
    value = quadratic.G @ d
    slack = _ACTIVE * (1.0 + np.abs(value))
    is_active = (value >= quadratic.upper - slack) | (value <= quadratic.lower + slack)
    is_inactive = (d < quadratic.high - _ACTIVE) & (d > quadratic.low + _ACTIVE)
    multipliers = np.zeros(len(value))
    if is_active.any() and is_inactive.any():
        gradient = (quadratic.H @ d + quadratic.f)[is_inactive]
        multipliers[is_active] = np.linalg.lstsq(
            quadratic.G[np.ix_(is_active, is_inactive)].T, -gradient, rcond=1e-9
        )[0]
    return multipliers


def create_step_solver(backend: ConvexBackend) -> StepSolver:
    """Create the step solver of a backend."""
    return DaqpStepSolver() if backend == "daqp" else SessionStepSolver(backend)


def project_to_convex(hessian: Array, scale: Array) -> Array:
    """Return the part of a symmetric matrix with positive eigenvalues, in scaled variables."""
    scaled = hessian * scale[:, None] * scale
    values, vectors = np.linalg.eigh(scaled)
    is_positive = values > 0
    projection = (vectors[:, is_positive] * values[is_positive]) @ vectors[:, is_positive].T
    return np.asarray(projection / scale[:, None] / scale)
