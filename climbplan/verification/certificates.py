"""Verification of certificates: what they claim, by the checker that knows no solver."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from scipy import sparse

from climbplan.certificates.checker import Verdict, check
from climbplan.program.problem import Problem
from climbplan.solvers.result import relative_gap
from climbplan.store.certified import CertifiedRow, CertifiedRows
from climbplan.verification.check import Check, LeftOut
from climbplan.verification.verification import Verification

_CLAIMED = 1e-9  # relative: what a proof may differ by from machine to machine
_NO_STATEMENT = LeftOut(
    "numbers of the file", "whether they are those of the statement is not looked at without "
    "--problem",
)  # fmt: skip


def verify_certificates(certified: CertifiedRows, problem: Problem | None = None) -> Verification:
    """Return every row's proof; with the statement also whether it is about that.

    Raises UsageError if the parameters are not those of the problem.
    """
    checks = tuple(_checks(certified, problem))
    return Verification(checks, beyond=() if problem is not None else (_NO_STATEMENT,))


def _checks(certified: CertifiedRows, problem: Problem | None) -> Iterator[Check]:
    digest = hashlib.sha256(certified.spec_text.encode()).hexdigest()
    yield _check("file.spec_hash", float(digest != certified.spec_sha256), 0.0)
    if problem is not None:
        found = [_differences(row, problem) for row in certified.rows]
        words = [", ".join(names) for names in found]
        yield _worst("certificate.statement", [float(len(names)) for names in found], 0.0, words)
    verdicts = [check(row.instance, row.certificate) for row in certified.rows]
    faults = [verdict.faults[0] if verdict.faults else "" for verdict in verdicts]
    yield _worst("certificate.proof", [float(bool(f)) for f in faults], 0.0, faults)
    pairs = list(zip(certified.rows, verdicts, strict=True))
    yield _worst("certificate.bound", [_overclaimed(*pair) for pair in pairs], _CLAIMED)
    off = [
        float(row.instance.violation(row.x, row.assignment))
        for row in certified.rows
        if row.x is not None
    ]
    if off:
        yield _worst("certificate.point", off, certified.tolerance)
    if proved := [_gap(*pair) for pair in pairs if pair[0].status == "optimal"]:
        yield _worst("certificate.gap", proved, certified.gap * (1.0 + 1e-6))
    if empty := [v for row, v in pairs if row.status == "infeasible"]:
        yield _worst("certificate.infeasible", [float(v.bound < np.inf) for v in empty], 0.0)


def _overclaimed(row: CertifiedRow, verdict: Verdict) -> float:
    """By how much the claim is more than what is proved, relative."""
    claimed = row.certificate.bound
    if np.isnan(claimed):
        return np.inf
    if claimed <= verdict.bound:
        return 0.0
    return float((claimed - verdict.bound) / max(abs(claimed), 1e-9))


def _gap(row: CertifiedRow, verdict: Verdict) -> float:
    """Between the answer and what is proved."""
    if row.x is None:
        return np.inf
    return relative_gap(row.instance.objective(row.x), verdict.bound)


def _differences(row: CertifiedRow, problem: Problem) -> list[str]:
    """Return which numbers of a row are not those of the statement at its parameters."""
    stated = problem.instance(problem.split(row.parameters))
    return [
        field.name
        for field in fields(stated)
        if not _same(getattr(stated, field.name), getattr(row.instance, field.name))
    ]


def _same(one: Any, other: Any) -> bool:
    """Return whether two values, matrices or records of them say the same to the last digit."""
    if sparse.issparse(one):
        return one.shape == other.shape and (sparse.csr_matrix(one) != other).nnz == 0
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if is_dataclass(one):
        if type(one) is not type(other):
            return False
        names = [field.name for field in fields(one) if field.name != "vertices"]
        return all(_same(getattr(one, name), getattr(other, name)) for name in names)
    return bool(one == other)


def _worst(
    name: str, residuals: list[float], limit: float, words: list[str] | None = None
) -> Check:
    at = int(np.argmax(residuals))
    place = f"row {at}" if residuals[at] > limit else ""
    if place and words is not None:
        place += f": {words[at]}"
    return _check(name, residuals[at], limit, place)


def _check(name: str, residual: float, limit: float, place: str = "") -> Check:
    passed = bool(residual <= limit)
    return Check(name, residual, limit, "", passed, "", place, residual / limit if limit else 0.0)
