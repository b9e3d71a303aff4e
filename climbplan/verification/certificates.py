"""Verification of certificates: what they claim, by the checker that knows no solver."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from scipy import sparse

from climbplan.certificates.checker import CertificateVerdict, check
from climbplan.program.problem import Problem
from climbplan.solvers.result import compute_zero_cost, relative_gap
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
    checks = tuple(_iterate_checks(certified, problem))
    beyond = () if problem is not None else (_NO_STATEMENT,)
    return Verification(checks, beyond=beyond, is_motion=False)


def _iterate_checks(certified: CertifiedRows, problem: Problem | None) -> Iterator[Check]:
    digest = hashlib.sha256(certified.spec_text.encode()).hexdigest()
    yield _build_check("file.spec_hash", float(digest != certified.spec_sha256), 0.0)
    if problem is not None:
        differences = [_find_differences(row, problem) for row in certified.rows]
        difference_texts = [", ".join(names) for names in differences]
        yield _check_worst(
            "certificate.statement",
            [float(len(names)) for names in differences],
            0.0,
            difference_texts,
        )
    verdicts = [check(row.instance, row.certificate) for row in certified.rows]
    faults = [verdict.faults[0] if verdict.faults else "" for verdict in verdicts]
    yield _check_worst("certificate.proof", [float(bool(f)) for f in faults], 0.0, faults)
    pairs = list(zip(certified.rows, verdicts, strict=True))
    yield _check_worst("certificate.bound", [_compute_overclaim(*pair) for pair in pairs], _CLAIMED)
    violations = [
        float(row.instance.violation(row.x, row.assignment))
        for row in certified.rows
        if row.x is not None
    ]
    if violations:
        yield _check_worst("certificate.point", violations, certified.tolerance)
    if gaps := [_compute_gap(*pair) for pair in pairs if pair[0].status == "optimal"]:
        yield _check_worst("certificate.gap", gaps, certified.gap * (1.0 + 1e-6))
    if infeasible_verdicts := [v for row, v in pairs if row.status == "infeasible"]:
        yield _check_worst(
            "certificate.infeasible", [float(v.bound < np.inf) for v in infeasible_verdicts], 0.0
        )


def _compute_overclaim(row: CertifiedRow, verdict: CertificateVerdict) -> float:
    """Return by how much the claim exceeds what is proved, relative."""
    claimed = row.certificate.bound
    if np.isnan(claimed):
        return np.inf
    if claimed <= verdict.bound:
        return 0.0
    return float((claimed - verdict.bound) / max(abs(claimed), 1e-9))


def _compute_gap(row: CertifiedRow, verdict: CertificateVerdict) -> float:
    """Return the relative gap between the answer and what is proved."""
    if row.x is None:
        return np.inf
    zero_cost = compute_zero_cost(row.instance)
    return relative_gap(row.instance.objective(row.x), verdict.bound, zero_cost)


def _find_differences(row: CertifiedRow, problem: Problem) -> list[str]:
    """Return which numbers of a row are not those of the statement at its parameters."""
    stated = problem.instance(problem.split(row.parameters))
    return [
        field.name
        for field in fields(stated)
        if not _is_equal(getattr(stated, field.name), getattr(row.instance, field.name))
    ]


def _is_equal(stored: Any, expected: Any) -> bool:
    """Return whether two values, matrices or records of them say the same to the last digit."""
    if sparse.issparse(stored):
        return stored.shape == expected.shape and (sparse.csr_matrix(stored) != expected).nnz == 0
    if isinstance(stored, np.ndarray):
        return np.array_equal(stored, expected)
    if isinstance(stored, tuple):
        return len(stored) == len(expected) and all(map(_is_equal, stored, expected))
    if is_dataclass(stored):
        if type(stored) is not type(expected):
            return False
        names = [field.name for field in fields(stored) if field.name != "vertices"]
        return all(_is_equal(getattr(stored, name), getattr(expected, name)) for name in names)
    return bool(stored == expected)


def _check_worst(
    name: str, residuals: list[float], limit: float, details: list[str] | None = None
) -> Check:
    worst_row = int(np.argmax(residuals))
    place = f"row {worst_row}" if residuals[worst_row] > limit else ""
    if place and details is not None:
        place += f": {details[worst_row]}"
    return _build_check(name, residuals[worst_row], limit, place)


def _build_check(name: str, residual: float, limit: float, place: str = "") -> Check:
    passed = bool(residual <= limit)
    return Check(name, residual, limit, "", passed, "", place, residual / limit if limit else 0.0)
