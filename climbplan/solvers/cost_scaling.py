"""Coordinates z in which all equations hold and the cost is 1/2 |z|^2.

x = center + X z, part by part: the equations of a part are eliminated by an orthonormal basis N of
their null space, and with the Cholesky factor N'PN = L L' the cost becomes 1/2 |z|^2 + constant
for z = L'w + L^-1 g.

Directions without cost get a tiny curvature about the middle of the variables' box. It adds at most
`loss` to the cost of a feasible point; the search subtracts that from every bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la

from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.solvers.bound_propagation import Box
from climbplan.solvers.components import Components, Equations
from climbplan.solvers.result import FEASIBILITY, Indices

_FLAT = 1e-9  # eigenvalues below this share of the largest count as zero
_CURVATURE = 1e-6  # added to flat directions, relative to the largest curvature of the cost
_RANK = 1e-9


@dataclass(frozen=True)
class ScaledCost:
    """x = center + X z, cost 1/2 |z|^2 + constant."""

    X: Array  # (n, k)
    center: Array  # (n,)
    constant: float
    loss: float  # infinite if a direction without cost is not bounded
    part: Indices  # (k,) part of each coordinate
    consistent: bool  # whether the equations have a solution


@dataclass(frozen=True)
class _Part:
    """One part's share of the map."""

    X: Array
    center: Array
    constant: float
    loss: float


def scaled_cost(
    instance: Instance, parts: Components, equal: Equations, box: Callable[[], Box]
) -> ScaledCost:
    """Eliminate equations and scale the cost; `box` is asked only if the cost is flat somewhere."""
    n = instance.size
    P, E = instance.P.toarray(), equal.E.toarray()
    top = float(np.abs(P).max(initial=0.0)) or 1.0
    equation_part = parts.of_rows(equal.E)
    center, constant, loss = np.zeros(n), instance.constant, 0.0
    columns: list[Array] = []
    labels: list[int] = []
    order = np.argsort(parts.variable, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(parts.variable, minlength=parts.count))[:-1])
    # Equations without variables only have to be true.
    empty = np.asarray(abs(equal.E).sum(axis=1)).ravel() == 0
    consistent = not (np.abs(equal.e[empty]) > FEASIBILITY).any()
    for label, index in enumerate(members):
        here = np.flatnonzero((equation_part == label) & ~empty)
        start, basis = _null_space(E[np.ix_(here, index)], equal.e[here])
        if start is None:
            return ScaledCost(np.zeros((n, 0)), center, constant, 0.0, np.zeros(0, int), False)
        part = _scaled(P[np.ix_(index, index)], instance.q[index], start, basis, index, top, box)
        center[index] = part.center
        constant += part.constant
        loss += part.loss
        block = np.zeros((n, part.X.shape[1]))
        block[index] = part.X
        columns.append(block)
        labels += [label] * part.X.shape[1]
    X = np.hstack(columns) if columns else np.zeros((n, 0))
    return ScaledCost(X, center, constant, loss, np.array(labels, np.int64), consistent)


def _null_space(E: Array, e: Array) -> tuple[Array | None, Array]:
    """A solution of E x = e (None if there is none) and an orthonormal basis of the null space."""
    n = E.shape[1]
    if not len(E):
        return np.zeros(n), np.eye(n)
    Q, R, order = la.qr(E.T, pivoting=True)
    rank = int((np.abs(np.diag(R)) > _RANK * max(1.0, float(np.abs(R).max(initial=0.0)))).sum())
    kept = order[:rank]
    start = Q[:, :rank] @ la.solve_triangular(R[:rank, :rank], e[kept], trans="T")
    if np.abs(E @ start - e).max() > FEASIBILITY:
        return None, Q[:, rank:]
    return start, Q[:, rank:]


def _scaled(
    P: Array,
    q: Array,
    start: Array,
    basis: Array,
    index: Indices,
    top: float,
    box: Callable[[], Box],
) -> _Part:
    """x = start + basis w of one part in scaled coordinates."""
    H, g = basis.T @ P @ basis, basis.T @ (P @ start + q)
    constant = float(0.5 * start @ P @ start + q @ start)
    loss = 0.0
    eigenvalues, vectors = np.linalg.eigh(H)
    flat = vectors[:, eigenvalues <= _FLAT * top]  # (k, f)
    if flat.size:
        limits = box()
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (limits.lower + limits.upper)[index]
            half = 0.5 * (limits.upper - limits.lower)[index]
        middle = np.where(np.isfinite(half), middle, 0.0)
        half = np.where(np.isfinite(half), half, np.inf)
        along = flat.T @ basis.T  # (f, variables)
        with np.errstate(invalid="ignore"):
            reach = np.nan_to_num(np.abs(along) * half, nan=0.0, posinf=np.inf).sum(axis=1)
        slope = np.abs(flat.T @ g)
        curvature = _CURVATURE * np.maximum(top, slope / np.maximum(reach, 1e-6))
        shift = along @ (middle - start)
        H = H + (flat * curvature) @ flat.T
        g = g - flat @ (curvature * shift)
        constant += float(0.5 * curvature @ shift**2)
        loss = float(0.5 * curvature @ reach**2)
    L = np.linalg.cholesky(H)
    shift = la.solve_triangular(L, g, lower=True)
    X = la.solve_triangular(L, basis.T, lower=True).T
    return _Part(X, start - X @ shift, constant - float(0.5 * shift @ shift), loss)
