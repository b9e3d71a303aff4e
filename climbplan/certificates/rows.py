"""All constraints of an instance as rows over v = (x, z, w), in one order.

x are its n variables, z a binary for each of the R alternatives of its choices, 1 for the chosen
one, and w its K products of two of x. Nothing is relaxed: a feasible x with its alternatives and
products satisfies all rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.certificates.rounding import round_down, round_up
from climbplan.errors import UsageError
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class CertificateRows:
    """Rows lower <= G v <= upper, of all v or of those whose binary has a value.

    In this order: plain rows, rows of implications, rows of alternatives (the products of the
    alternative's and the choice's matrices in doubles), one of each choice, coordinates of balls.
    In place of a cone's coordinates it is first that radius + slope x is not negative, then empty.
    """

    G: sparse.csr_matrix  # (rows, N)
    lower: Array  # (rows,)
    upper: Array
    binary: IntArray  # (rows,) variable of v that activates the row, -1 for none
    value: IntArray  # (rows,) its value at which the row is active
    integer: BoolArray  # (N,) mask of v
    first: IntArray  # (K,) first factors of w
    second: IntArray
    w: IntArray  # (K,) indices of w in v


def build_stated_rows(instance: Instance) -> CertificateRows:
    """Build the rows of an instance; raise UsageError for smooth rows."""
    if instance.smooth is not None:
        raise UsageError(f"{instance.name}: expected a program without smooth rows")
    n, K = instance.size, instance.products.count
    R = sum(len(choice.alternatives) for choice in instance.choices)
    blocks = []

    def append(A: Any, low: Array, high: Array, b: Any = -1, value: Any = 0, Q: Any = None) -> None:
        Q = sparse.csr_matrix((len(low), K)) if Q is None else Q
        z = sparse.csr_matrix((len(low), n + R - A.shape[1]))
        b, value = np.broadcast_to(b, len(low)), np.broadcast_to(value, len(low))
        blocks.append((sparse.hstack([A, z, Q]), low, high, b, value))

    implied = instance.implications
    append(instance.A, instance.row_lower, instance.row_upper, Q=instance.Q)
    append(implied.A, implied.lower, implied.upper, implied.binary, implied.value, implied.Q)
    choice_rows, z = np.zeros((len(instance.choices), n + R)), n
    for choice_row, choice in zip(choice_rows, instance.choices, strict=True):
        for p in choice.alternatives:
            matrix = np.vstack([p.A, p.C])
            shift = matrix @ choice.e
            low, high = np.append(np.full(len(p.b), -np.inf), p.c), np.append(p.b, p.c)
            append(sparse.csr_matrix(matrix) @ choice.E, low - shift, high - shift, z, 1)
            choice_row[z] = 1.0
            z += 1
    append(sparse.csr_matrix(choice_rows), np.ones(len(choice_rows)), np.ones(len(choice_rows)))
    for balls in instance.balls:
        d, f, radius = balls.f.shape[1], balls.f.ravel(), np.repeat(balls.radius, balls.f.shape[1])
        if balls.slope is None:
            append(balls.F, round_down(-radius - f), round_up(radius - f))
            continue
        low, high = np.where(np.arange(len(f)) % d, -np.inf, -radius), np.full(len(f), np.inf)
        append(sparse.kron(balls.slope, np.eye(d, 1)).tocsr(), low, high)
    G, *columns = zip(*blocks, strict=True)
    lower, upper, binary, value = (np.concatenate(column) for column in columns)
    matrix = sparse.csr_matrix(sparse.vstack(G))
    matrix.eliminate_zeros()
    integer = np.concatenate([instance.integer, np.ones(R, bool), np.zeros(K, bool)])
    products = instance.products.first, instance.products.second, np.arange(n + R, n + R + K)
    return CertificateRows(matrix, lower, upper, binary, value.astype(np.int64), integer, *products)


def append_envelopes(rows: CertificateRows, lower: Array, upper: Array) -> CertificateRows:
    """Append the envelopes of w = x y in a box (McCormick 1976), four rows each.

    With an end f of x's range and an end g of y's, (x - f) (y - g) has one sign in the box: that of
    w - g x - f y + f g.
    """
    K, plane = len(rows.w), np.tile(np.arange(4), len(rows.w))
    x, y, w = (np.repeat(places, 4) for places in (rows.first, rows.second, rows.w))
    f = np.where((plane == 0) | (plane == 3), lower[x], upper[x])
    g = np.where(plane % 2 == 0, lower[y], upper[y])
    # Both entries of a square stay separate, as their sum would be rounded
    entries, places = np.stack([np.ones(4 * K), -g, -f], 1), np.stack([w, x, y], 1)
    begin = 3 * np.arange(4 * K + 1)
    planes = sparse.csr_matrix((entries.ravel(), places.ravel(), begin), (4 * K, rows.G.shape[1]))
    return replace(
        rows,
        G=sparse.csr_matrix(sparse.vstack([rows.G, planes])),
        lower=np.append(rows.lower, np.where(plane < 2, round_down(-f * g), -np.inf)),
        upper=np.append(rows.upper, np.where(plane < 2, np.inf, round_up(-f * g))),
        binary=np.append(rows.binary, np.full(4 * K, -1)),
        value=np.append(rows.value, np.zeros(4 * K, np.int64)),
    )
