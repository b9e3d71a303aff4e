"""Linear algebra of small vectors and matrices, without allocation.

Calls of NumPy's functions would take longer than the arithmetic. Results are written to `out`.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled


@compiled
def _cross(a: Array, b: Array, out: Array) -> None:
    """Compute out = a x b; out must be neither."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def _dot(a: Array, b: Array) -> float:
    """Return a . b of vectors (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def _apply_matrix(matrix: Array, vector: Array, out: Array) -> None:
    """Compute out = matrix @ vector, of (3, 3) and (3,)."""
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]


@compiled
def _apply_wide_matrix(matrix: Array, vector: Array, out: Array) -> None:
    """Compute out (3,) = matrix (3, n) @ vector (n,)."""
    for i in range(3):
        total = 0.0
        for j in range(len(vector)):
            total += matrix[i, j] * vector[j]
        out[i] = total


@compiled
def _add_matrix_product(matrix: Array, vector: Array, out: Array) -> None:
    """Add matrix (n, 3) @ vector (3,) to out (n,)."""
    for j in range(len(out)):
        out[j] += matrix[j, 0] * vector[0] + matrix[j, 1] * vector[1] + matrix[j, 2] * vector[2]


@compiled
def _apply_transpose(matrix: Array, vector: Array, out: Array) -> None:
    """Compute out = matrix.T @ vector, of (3, 3) and (3,)."""
    for i in range(3):
        out[i] = matrix[0, i] * vector[0] + matrix[1, i] * vector[1] + matrix[2, i] * vector[2]


@compiled
def _transform_matrix(outer: Array, inner: Array, buffer: Array, out: Array) -> None:
    """Compute out = outer @ inner @ outer.T, all (3, 3); buffer: (3, 3)."""
    for i in range(3):
        for j in range(3):
            buffer[i, j] = (
                inner[i, 0] * outer[j, 0] + inner[i, 1] * outer[j, 1] + inner[i, 2] * outer[j, 2]
            )
    for i in range(3):
        for j in range(3):
            out[i, j] = (
                outer[i, 0] * buffer[0, j] + outer[i, 1] * buffer[1, j] + outer[i, 2] * buffer[2, j]
            )


@compiled
def _invert(matrix: Array, out: Array) -> float:
    """Compute out = matrix^-1 (3, 3) by cofactors and return the determinant.

    A singular matrix leaves `out` not finite.
    """
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    g, h, i = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    p, q, r = e * i - f * h, f * g - d * i, d * h - e * g
    volume = a * p + b * q + c * r
    scale = 1.0 / volume
    out[0, 0], out[0, 1], out[0, 2] = p * scale, (c * h - b * i) * scale, (b * f - c * e) * scale
    out[1, 0], out[1, 1], out[1, 2] = q * scale, (a * i - c * g) * scale, (c * d - a * f) * scale
    out[2, 0], out[2, 1], out[2, 2] = r * scale, (b * g - a * h) * scale, (a * e - b * d) * scale
    return float(volume)


@compiled
def _rotate(rotation: Array, turn: Array) -> None:
    """Compute rotation = exp(turn) rotation, in place, by the unit quaternion of the turn (3,)."""
    angle = np.sqrt(_dot(turn, turn))
    if angle < 1e-14:
        return
    w, s = np.cos(angle / 2), np.sin(angle / 2) / angle
    x, y, z = s * turn[0], s * turn[1], s * turn[2]
    m00, m01, m02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    m10, m11, m12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    m20, m21, m22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for j in range(3):
        a, b, c = rotation[0, j], rotation[1, j], rotation[2, j]
        rotation[0, j] = m00 * a + m01 * b + m02 * c
        rotation[1, j] = m10 * a + m11 * b + m12 * c
        rotation[2, j] = m20 * a + m21 * b + m22 * c


@compiled
def _solve_positive_definite(matrix: Array, vector: Array) -> bool:
    """Solve matrix x = vector (6) in place, which destroys the matrix.

    Returns False unless all pivots are positive. There is no pivoting: the stiffness of a body in
    stable equilibrium has positive pivots, and a body that buckles is detected.
    """
    for k in range(6):
        pivot = matrix[k, k]
        if not pivot > 1e-9:
            return False
        for i in range(k + 1, 6):
            factor = matrix[i, k] / pivot
            if factor != 0.0:
                for j in range(k + 1, 6):
                    matrix[i, j] -= factor * matrix[k, j]
                vector[i] -= factor * vector[k]
    for k in range(5, -1, -1):
        total = vector[k]
        for j in range(k + 1, 6):
            total -= matrix[k, j] * vector[j]
        vector[k] = total / matrix[k, k]
    return True


@compiled
def _set_diagonal(diagonal: Array, matrix: Array) -> None:
    """Set a matrix (n, n) to a diagonal (n,), zero elsewhere."""
    matrix[:] = 0.0
    for j in range(len(diagonal)):
        matrix[j, j] = diagonal[j]


@compiled
def _set_identity(matrix: Array) -> None:
    """Set a matrix (3, 3) to the identity."""
    for i in range(3):
        for j in range(3):
            matrix[i, j] = 1.0 if i == j else 0.0


@compiled
def _copy_rows(source: Array, target: Array) -> None:
    """Copy an array (N, n) to another."""
    for i in range(len(source)):
        for a in range(source.shape[1]):
            target[i, a] = source[i, a]
