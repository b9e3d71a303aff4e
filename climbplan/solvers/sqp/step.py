"""One step of the method: a small dense convex quadratic program by DAQP, Clarabel or OSQP.

Variables are steps in units of their scale; a proximal term makes the Hessian definite, which is
what a dual active-set method needs, and vanishes where the iteration stands still.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import daqp
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.instance import Implications, Instance, Products
from climbplan.solvers.convex.sessions import ConvexBackend, session

_UNBOUNDED = 1e30
_EQUAL, _INEQUALITY = 5, 0
_ACTIVE = 1e-6  # rows and variables this near to an end are at it
_OPTIMAL, _INFEASIBLE = 1, -1
_PRIMAL_TOLERANCES = (1e-8, 1e-6)  # the second where DAQP cycles at the first
_ITERATIONS = 500


@dataclass(frozen=True)
class Quadratic:
    """minimise 1/2 d'H d + f'd over low <= d <= high, lower <= G d <= upper."""

    H: Array  # (r, r) positive definite
    f: Array  # (r,)
    low: Array
    high: Array
    G: Array  # (m, r)
    lower: Array
    upper: Array


@dataclass(frozen=True)
class Step:
    """What a solver made of a quadratic program."""

    d: Array | None  # (r,)
    multipliers: Array  # (m,) of the rows, positive at their upper ends
    infeasible: bool  # its word; otherwise, without a step, it gave up


class StepSolver(Protocol):
    """Solves the quadratic programs of all steps."""

    def solve(self, quadratic: Quadratic) -> Step:
        """Solve one."""


class DaqpSteps:
    """DAQP on dense arrays."""

    def solve(self, quadratic: Quadratic) -> Step:
        """Rows are scaled by DAQP itself."""
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
                # Equations that depend on each other fail before the first iteration.
                sense = np.zeros_like(sense)
        return Step(None, np.zeros(len(quadratic.lower)), flag == _INFEASIBLE)


class SessionSteps:
    """Clarabel or OSQP through their sessions, which keep multipliers to themselves."""

    def __init__(self, backend: ConvexBackend) -> None:
        self._session = session(backend)

    def solve(self, quadratic: Quadratic) -> Step:
        """Fixed shapes only change numbers."""
        r, m = len(quadratic.f), len(quadratic.lower)
        none = np.zeros(0, np.int64)
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
            products=Products(none, none),
            Q=empty((m, 0)),
            implications=Implications(
                empty((0, r)), empty((0, 0)), np.zeros(0), np.zeros(0), none, none > 0
            ),
        )
        answer = self._session.solve(instance)
        if answer.infeasible or answer.x is None:
            return Step(None, np.zeros(m), answer.infeasible)
        return Step(answer.x, _multipliers(quadratic, answer.x), False)


def _multipliers(quadratic: Quadratic, d: Array) -> Array:
    """Of the rows (m,), by least squares over those at their ends."""
    value = quadratic.G @ d
    slack = _ACTIVE * (1.0 + np.abs(value))
    held = (value >= quadratic.upper - slack) | (value <= quadratic.lower + slack)
    inside = (d < quadratic.high - _ACTIVE) & (d > quadratic.low + _ACTIVE)
    out = np.zeros(len(value))
    if held.any() and inside.any():
        gradient = (quadratic.H @ d + quadratic.f)[inside]
        out[held] = np.linalg.lstsq(quadratic.G[np.ix_(held, inside)].T, -gradient, rcond=1e-9)[0]
    return out


def step_solver(backend: ConvexBackend) -> StepSolver:
    """The solver of a name."""
    return DaqpSteps() if backend == "daqp" else SessionSteps(backend)


def convex_part(hessian: Array, scale: Array) -> Array:
    """The part of a symmetric matrix with positive eigenvalues, in scaled variables."""
    scaled = hessian * scale[:, None] * scale
    values, vectors = np.linalg.eigh(scaled)
    kept = values > 0
    part = (vectors[:, kept] * values[kept]) @ vectors[:, kept].T
    return np.asarray(part / scale[:, None] / scale)
