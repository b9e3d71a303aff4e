"""Force problems on the exact friction cones by Clarabel, an interior-point method."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.climb.forces.reduction import ReducedForces, build_halfspaces

_LOOSE_TOLERANCE, _REGULARISATION = 1e-8, 1e-6
_TOLERANCE = 1e-10  # feasibility and gap, in units of the load


@dataclass(frozen=True)
class ConeOptima:
    """Clarabel's answers to B problems; not yet checked."""

    x: Array  # (B, q + 1) s and y
    solved: BoolArray  # (B,)


def build_clarabel_settings(robust: bool = False) -> clarabel.DefaultSettings:
    """Return settings for one quiet thread: tight tolerances, or looser ones with `robust`.

    The looser ones are for problems on which Clarabel gives up with tight tolerances.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = (
        _LOOSE_TOLERANCE if robust else _TOLERANCE
    )
    if robust:
        settings.static_regularization_constant = _REGULARISATION
    return settings


_redirecting = threading.Lock()  # the file descriptor belongs to all threads


def _open_scratch_file() -> int:
    """Return the descriptor of a file without a name, in memory where the system has such files."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("stderr")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


@contextmanager
def _drop_panic_message() -> Iterator[None]:
    """Keep back standard error, and drop what is written to it before an exception.

    Rust prints a panic, and under RUST_BACKTRACE its stack, to the file descriptor before Python
    sees an exception.
    """
    with _redirecting:
        if sys.stderr is not None:
            sys.stderr.flush()
        try:
            original = os.dup(2)
        except OSError:  # standard error is closed
            yield
            return
        kept_back = _open_scratch_file()
        try:
            os.dup2(kept_back, 2)
            yield
            os.dup2(original, 2)
            os.lseek(kept_back, 0, os.SEEK_SET)
            while text := os.read(kept_back, 1 << 16):
                os.write(2, text)
        finally:
            os.dup2(original, 2)
            os.close(original)
            os.close(kept_back)


def solve_with_clarabel(*problem: Any) -> clarabel.DefaultSolution | None:
    """Solve a problem by Clarabel; return None, and print nothing, where Clarabel panics.

    problem: the arguments of `DefaultSolver`. An eigenvalue iteration on a semidefinite cone that
    does not converge makes it panic. PyO3 raises a BaseException whose type it does not export.
    """
    try:
        with _drop_panic_message():
            return clarabel.DefaultSolver(*problem).solve()
    except BaseException as error:
        kind = type(error)
        if (kind.__module__, kind.__name__) != ("pyo3_runtime", "PanicException"):
            raise
        return None


def solve_clarabel(group: ReducedForces) -> ConeOptima:
    """Minimise a group's objective and preference over the exact cones, one call an instant."""
    b, n, q = len(group.instant), group.num_contacts, group.num_unknowns
    linear = build_halfspaces(group)
    # s >= 0 and s <= max_s, then torque, contact and commands, then (mu n . f, t . f, b . f)
    # in a cone, and what the forces leave of the stiffness
    m = 2 + linear.A.shape[1]
    cone_end = m + 3 * n
    size = cone_end + group.stability.shape[1]
    A, upper = np.zeros((b, size, q + 1)), np.zeros((b, size))
    A[:, 0, 0], A[:, 1, 0] = -1.0, 1.0
    upper[:, 1] = group.max_s
    A[:, 2:m], upper[:, 2:m] = linear.A, linear.upper
    slopes = np.ones((b, n, 3))
    slopes[..., 0] = group.usable_mu
    A[:, m:cone_end, 1:] = -(slopes[..., None] * group.frame_null_space).reshape(b, 3 * n, q)
    reserved = group.frame_particular.copy()
    reserved[..., 0] -= group.reserve[:, None]
    upper[:, m:cone_end] = (slopes * reserved).reshape(b, 3 * n)
    A[:, cone_end:, 1:], upper[:, cone_end:] = group.stability, group.stability_upper

    cones = [clarabel.NonnegativeConeT(m), *[clarabel.SecondOrderConeT(3)] * n]
    if size > cone_end:
        cones.append(clarabel.PSDTriangleConeT(6))
    gradient = group.gradient + group.preference_gradient
    settings = build_clarabel_settings()
    # All entries are stored, zeros as well: one sparsity pattern for the whole batch.
    indptr = np.arange(q + 2) * size
    indices = np.tile(np.arange(size), q + 1)
    values = np.ascontiguousarray(np.swapaxes(A, 1, 2)).reshape(b, -1)
    x, solved = np.zeros((b, q + 1)), np.zeros(b, bool)
    for k in range(b):
        matrix = sparse.csc_matrix((values[k], indices, indptr), shape=(size, q + 1))
        P = sparse.csc_matrix(np.triu(group.preference[k]))
        solution = solve_with_clarabel(P, gradient[k], matrix, upper[k], cones, settings)
        if solution is None:
            continue
        x[k] = solution.x
        # "Almost" only missed the tight tolerance; the check of the forces decides.
        solved[k] = str(solution.status) in ("Solved", "AlmostSolved", "InsufficientProgress")
    return ConeOptima(x, solved)
