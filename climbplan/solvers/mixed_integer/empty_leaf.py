"""Multipliers that prove a leaf empty: of the program that asks how far its rows must be let out.

Least t >= 0 such that some x has every row within t; conditional rows whose integer is open may
fail by what they can in the box. HiGHS solves it; where t is more than 0 its multipliers are the
proof, and t is its margin. Tangents to balls are added where their points violate them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from climbplan.certificates.certificate import Certificate
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.pairs import row_intervals

_NOTHING = 1e-9  # a margin that proves nothing
_ENOUGH = 1e-6  # one that needs no further tangents, which could only widen it
_ROUNDS = 40  # of tangents


@dataclass(frozen=True)
class EmptyLeaf:
    """Multipliers of rows and balls."""

    multiplier: Array  # (rows,)
    ball: Array  # (D,)


def multipliers_of_empty(
    instance: Instance, form: Conditional, certificate: Certificate, leaf: int
) -> EmptyLeaf | None:
    """The proof that a leaf is empty, None if there is none."""
    lower, upper = _bounds(instance, form, certificate, leaf)
    rows = _rows(instance, form, certificate, lower, upper)
    one_of = _one_of(form)
    coordinates = sum(balls.f.size for balls in instance.balls)
    tangents = np.zeros((0, coordinates))
    for _ in range(_ROUNDS):
        G, high = _with_tangents(instance, rows, tangents)
        found = linprog(
            np.append(np.zeros(form.size), 1.0),
            A_ub=sparse.hstack([G, -np.ones((len(high), 1))]).tocsr(),
            b_ub=high,
            A_eq=one_of if one_of.shape[0] else None,
            b_eq=np.ones(one_of.shape[0]) if one_of.shape[0] else None,
            bounds=np.stack([np.append(lower, 0.0), np.append(upper, np.inf)], axis=1),
            method="highs",
        )
        if found.status != 0:
            return None
        if found.fun > _ENOUGH:
            break
        new = _violated(instance, found.x[: instance.size], found.fun)
        if not len(new):
            break
        tangents = np.vstack([tangents, new])
    else:
        return None
    if found.fun <= _NOTHING:
        return None
    weight = np.maximum(-np.asarray(found.ineqlin.marginals), 0.0)
    multiplier = np.zeros(len(instance.row_lower) + len(form.when))
    count = len(rows.place)
    np.add.at(multiplier, rows.place, -rows.sign * weight[:count])
    ball = weight[count:] @ tangents if len(tangents) else np.zeros(coordinates)
    return EmptyLeaf(multiplier, ball)


@dataclass(frozen=True)
class _Rows:
    """G x <= high."""

    G: sparse.csr_matrix  # (r, size of the form)
    high: Array
    place: Index  # (r,) of the row in the statement
    sign: Index  # (r,) 1 for an upper side, -1 for a lower one


def _bounds(
    instance: Instance, form: Conditional, c: Certificate, leaf: int
) -> tuple[Array, Array]:
    """Of the form's variables in a leaf."""
    n = instance.size
    lower, upper = np.zeros(form.size), np.ones(form.size)
    lower[:n], upper[:n] = c.lower, c.upper
    integers = np.flatnonzero(instance.integer)
    lower[integers] = np.maximum(lower[integers], c.low[leaf])
    upper[integers] = np.minimum(upper[integers], c.high[leaf])
    at = 0
    for choice, binaries in zip(instance.choices, form.choice, strict=True):
        allowed = c.allowed[leaf, at : at + len(choice.alternatives)]
        at += len(choice.alternatives)
        if len(allowed) == 2:
            lower[binaries[0]], upper[binaries[0]] = float(not allowed[1]), float(allowed[0])
        else:
            upper[binaries] = allowed
            lower[binaries] = allowed & (allowed.sum() == 1)
    return lower, upper


def _rows(
    instance: Instance, form: Conditional, c: Certificate, lower: Array, upper: Array
) -> _Rows:
    """Both sides of every row; conditional ones that are open may fail by what they can."""
    plain, z = len(instance.row_lower), form.when
    extra = form.size - instance.size
    box = [np.concatenate([side, fill]) for side, fill in
           ((c.lower, np.zeros(extra)), (c.upper, np.ones(extra)))]  # fmt: skip
    least, most = row_intervals(form.C.indptr, form.C.indices, form.C.data, *box)
    with np.errstate(invalid="ignore"):  # a side that is not there
        over, under = most - form.when_upper, form.when_lower - least
    holds = (lower[z] == form.value) & (upper[z] == form.value)
    A = sparse.csr_matrix(
        (instance.A.data, instance.A.indices, instance.A.indptr), (plain, form.size)
    )
    G, high = [], []
    for sign, side, when, fails in (
        (1, instance.row_upper, form.when_upper, over),
        (-1, -instance.row_lower, -form.when_lower, under),
    ):
        room = np.where(holds, 0.0, np.maximum(fails, 0.0))
        known = np.isfinite(room)  # others say nothing while they are open
        slope = np.where(known, np.where(form.value == 1, room, -room), 0.0)
        G += [sign * A, sign * form.C + sparse.csr_matrix((slope, (np.arange(len(z)), z)),
                                                          form.C.shape)]  # fmt: skip
        constant = np.where(known & (form.value == 1), room, 0.0)
        high += [side, np.where(known, when + constant, np.inf)]
    count = plain + len(z)
    kept = np.isfinite(np.concatenate(high))
    return _Rows(
        sparse.vstack(G).tocsr()[kept],
        np.concatenate(high)[kept],
        np.tile(np.arange(count), 2)[kept],
        np.repeat([1, -1], count)[kept],
    )


def _one_of(form: Conditional) -> sparse.csr_matrix:
    """Rows that add the binaries of each choice up, with a column for t."""
    groups = [binaries for binaries in form.choice if len(binaries) > 1]
    row = np.repeat(np.arange(len(groups)), [len(g) for g in groups])
    column = np.concatenate([np.zeros(0, int), *groups]).astype(int)
    return sparse.csr_matrix((np.ones(len(column)), (row, column)), (len(groups), form.size + 1))


def _with_tangents(
    instance: Instance, rows: _Rows, tangents: Array
) -> tuple[sparse.csr_matrix, Array]:
    """The rows, and b'(F x + f) <= |b| r for each tangent b."""
    if not len(tangents):
        return rows.G, rows.high
    F = sparse.vstack([balls.F for balls in instance.balls])
    f = np.concatenate([balls.f.ravel() for balls in instance.balls])
    radius = np.concatenate([np.repeat(b.radius, b.f.shape[1]) for b in instance.balls])
    G = sparse.csr_matrix(tangents @ F)
    G = sparse.csr_matrix((G.data, G.indices, G.indptr), (len(tangents), rows.G.shape[1]))
    # One ball each, of unit length
    reach = (tangents**2) @ radius
    return sparse.vstack([rows.G, G]).tocsr(), np.concatenate([rows.high, reach - tangents @ f])


def _violated(instance: Instance, x: Array, t: float) -> Array:
    """Directions (T, D) of the balls that x violates by more than t."""
    coordinates = sum(balls.f.size for balls in instance.balls)
    out, at = [], 0
    for balls in instance.balls:
        vectors = balls.vectors(x)
        length = np.linalg.norm(vectors, axis=1)
        for k, vector in enumerate(vectors):
            if length[k] > balls.radius[k] + t + 1e-3 * max(t, _NOTHING):
                row = np.zeros(coordinates)
                row[at : at + len(vector)] = vector / length[k]
                out.append(row)
            at += len(vector)
    return np.array(out).reshape(len(out), coordinates)
