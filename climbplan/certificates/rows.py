"""All that an instance asks for as rows over v = (x, z, w), in one order.

x are its n variables, z a binary for each of the R alternatives of its choices, 1 for the one that
is taken, and w its K products of two of x. Nothing is relaxed: a feasible x with its alternatives
and its products satisfies all rows, each of which the instance states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.certificates.rounding import down, up
from climbplan.errors import UsageError
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class StatedRows:
    """lower <= G v <= upper, of all v or of those whose binary has a value.

    In this order: plain rows, those of implications, those of alternatives (the products of the
    alternative's and the choice's matrices in doubles), one of each choice, coordinates of balls.
    """

    G: sparse.csr_matrix  # (rows, N)
    lower: Array  # (rows,)
    upper: Array
    binary: IntArray  # (rows,) which of v decides whether a row has to hold, -1
    value: IntArray  # (rows,) that it then has
    integer: BoolArray  # (N,) of v
    first: IntArray  # (K,) factors of w
    second: IntArray
    w: IntArray  # (K,) its places in v


def stated_rows(instance: Instance) -> StatedRows:
    """The rows of an instance. Raises UsageError for smooth rows, of which nothing is proved."""
    if instance.smooth is not None:
        raise UsageError(f"{instance.name}: no certificate holds smooth rows")
    n, K = instance.size, instance.products.count
    R = sum(len(choice.alternatives) for choice in instance.choices)
    parts = []

    def put(A: Any, low: Array, high: Array, b: Any = -1, value: Any = 0, Q: Any = None) -> None:
        Q = sparse.csr_matrix((len(low), K)) if Q is None else Q
        z = sparse.csr_matrix((len(low), n + R - A.shape[1]))
        b, value = np.broadcast_to(b, len(low)), np.broadcast_to(value, len(low))
        parts.append((sparse.hstack([A, z, Q]), low, high, b, value))

    i = instance.implications
    put(instance.A, instance.row_lower, instance.row_upper, Q=instance.Q)
    put(i.A, i.lower, i.upper, i.binary, i.value, i.Q)
    one_of, z = np.zeros((len(instance.choices), n + R)), n
    for taken, choice in zip(one_of, instance.choices, strict=True):
        for p in choice.alternatives:
            matrix = np.vstack([p.A, p.C])
            shift = matrix @ choice.e
            low, high = np.append(np.full(len(p.b), -np.inf), p.c), np.append(p.b, p.c)
            put(sparse.csr_matrix(matrix) @ choice.E, low - shift, high - shift, z, 1)
            taken[z] = 1.0
            z += 1
    put(sparse.csr_matrix(one_of), np.ones(len(one_of)), np.ones(len(one_of)))
    for balls in instance.balls:
        reach, f = np.repeat(balls.radius, balls.f.shape[1]), balls.f.ravel()
        put(balls.F, down(-reach - f), up(reach - f))
    G, *columns = zip(*parts, strict=True)
    lower, upper, binary, value = (np.concatenate(column) for column in columns)
    matrix = sparse.csr_matrix(sparse.vstack(G))
    matrix.eliminate_zeros()
    integer = np.concatenate([instance.integer, np.ones(R, bool), np.zeros(K, bool)])
    products = instance.products.first, instance.products.second, np.arange(n + R, n + R + K)
    return StatedRows(matrix, lower, upper, binary, value.astype(np.int64), integer, *products)


def with_planes(rows: StatedRows, lower: Array, upper: Array) -> StatedRows:
    """The rows, and behind them the envelopes of w = x y in a box (McCormick 1976), four each.

    With f an end of x's range and g one of y's, (x - f) (y - g) has one sign in the box: that of
    w - g x - f y + f g.
    """
    K, plane = len(rows.w), np.tile(np.arange(4), len(rows.w))
    x, y, w = (np.repeat(places, 4) for places in (rows.first, rows.second, rows.w))
    f = np.where((plane == 0) | (plane == 3), lower[x], upper[x])
    g = np.where(plane % 2 == 0, lower[y], upper[y])
    # Both entries of a square are kept apart, as their sum would be rounded
    entries, places = np.stack([np.ones(4 * K), -g, -f], 1), np.stack([w, x, y], 1)
    begin = 3 * np.arange(4 * K + 1)
    planes = sparse.csr_matrix((entries.ravel(), places.ravel(), begin), (4 * K, rows.G.shape[1]))
    return replace(
        rows,
        G=sparse.csr_matrix(sparse.vstack([rows.G, planes])),
        lower=np.append(rows.lower, np.where(plane < 2, down(-f * g), -np.inf)),
        upper=np.append(rows.upper, np.where(plane < 2, np.inf, up(-f * g))),
        binary=np.append(rows.binary, np.full(4 * K, -1)),
        value=np.append(rows.value, np.zeros(4 * K, np.int64)),
    )
