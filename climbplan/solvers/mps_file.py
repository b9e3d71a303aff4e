"""MPS files of mixed-integer programs with convex quadratic costs and balls.

Free format with the sections QUADOBJ (upper triangle of P in 1/2 x'Px) and QCMATRIX (all entries of
Q in x'Qx + q'x <= r, one section for each ball), as Gurobi, CPLEX and SCIP read them. A ball
|F x + f| <= r is the row x'F'F x + 2 f'F x <= r^2 - f'f, so no variable is added.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy import sparse

from climbplan.errors import UsageError
from climbplan.program.instance import Instance

_INTEGERS = "    MARKER  'MARKER'  '{}'"


def write_mps(instance: Instance, names: list[str], path: Path) -> None:
    """Write an instance of rows, integers and balls.

    Args:
        instance: The instance, without choices, implications, products and cones.
        names: (n,) names of the variables.
        path: The file.

    Raises:
        UsageError: The instance has other features, or the file cannot be written.
    """
    if unsupported := instance.features - {"balls", "integers", "integers beyond 0 and 1"}:
        raise UsageError(f"{path}: {', '.join(sorted(unsupported))} cannot be written")
    try:
        path.write_text("\n".join(_iterate_lines(instance, names)) + "\n", encoding="ascii")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def _iterate_lines(instance: Instance, names: list[str]) -> Iterator[str]:
    """Yield the lines of the file."""
    matrices, gradients, limits = _build_ball_rows(instance)
    A = sparse.vstack([sparse.csr_matrix(instance.A), gradients]).tocsc()
    low = np.append(instance.row_lower, np.full(len(limits), -np.inf))
    high = np.append(instance.row_upper, limits)
    count = instance.A.shape[0]
    rows = [f"row{i}" if i < count else f"ball{i - count}" for i in range(len(high))]
    yield from ("NAME climbplan FREE", "ROWS", " N cost")
    for row, lower, upper in zip(rows, low, high, strict=True):
        kind = "E" if lower == upper else "L" if np.isfinite(upper) else "G"
        yield f" {kind if np.isfinite([lower, upper]).any() else 'N'} {row}"
    yield "COLUMNS"
    for integer in (False, True):
        columns = np.flatnonzero(instance.integer == integer)
        if integer and len(columns):
            yield _INTEGERS.format("INTORG")
        for j in columns:
            yield f" {names[j]} cost {instance.q[j]:.17g}"
            for entry in range(A.indptr[j], A.indptr[j + 1]):
                yield f" {names[j]} {rows[A.indices[entry]]} {A.data[entry]:.17g}"
        if integer and len(columns):
            yield _INTEGERS.format("INTEND")
    yield "RHS"
    yield f" RHS cost {-instance.constant:.17g}"
    ranges = ["RANGES"]
    for row, lower, upper in zip(rows, low, high, strict=True):
        if np.isfinite([lower, upper]).any():
            yield f" RHS {row} {upper if np.isfinite(upper) else lower:.17g}"
        if np.isfinite([lower, upper]).all() and lower < upper:
            ranges.append(f" RNG {row} {upper - lower:.17g}")
    yield from ranges if len(ranges) > 1 else ()
    yield "BOUNDS"
    for name, lower, upper in zip(names, instance.lower, instance.upper, strict=True):
        yield f" LO BND {name} {lower:.17g}" if np.isfinite(lower) else f" MI BND {name}"
        yield f" UP BND {name} {upper:.17g}" if np.isfinite(upper) else f" PL BND {name}"
    if instance.P.count_nonzero():
        yield from _iterate_entries("QUADOBJ", sparse.triu(instance.P), names)
    for k, matrix in enumerate(matrices):
        yield from _iterate_entries(f"QCMATRIX ball{k}", matrix, names)
    yield "ENDATA"


def _iterate_entries(head: str, matrix: sparse.spmatrix, names: list[str]) -> Iterator[str]:
    """Yield a section of a matrix, each entry once."""
    entries = sparse.csr_matrix(matrix)
    entries.sum_duplicates()
    entries.eliminate_zeros()
    places = entries.tocoo()
    yield head
    for i, j, value in zip(places.row, places.col, places.data, strict=True):
        yield f" {names[i]} {names[j]} {value:.17g}"


def _build_ball_rows(
    instance: Instance,
) -> tuple[list[sparse.csr_matrix], sparse.csr_matrix, list[float]]:
    """Return F'F, the rows 2 f'F, and r^2 - f'f of all balls."""
    matrices: list[sparse.csr_matrix] = []
    gradients, limits = [sparse.csr_matrix((0, instance.size))], []
    for balls in instance.balls:
        d = balls.f.shape[1]
        for k, (f, radius) in enumerate(zip(balls.f, balls.radius, strict=True)):
            F = sparse.csr_matrix(balls.F[k * d : (k + 1) * d])
            matrices.append(sparse.csr_matrix(F.T @ F))
            gradients.append(sparse.csr_matrix(2.0 * f[None] @ F))
            limits.append(float(radius**2 - f @ f))
    return matrices, sparse.vstack(gradients).tocsr(), limits
