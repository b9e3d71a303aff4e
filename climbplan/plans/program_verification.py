"""Verification of answers to a stated program.

Without the statement only the file itself can be checked: its text, the bounds that it stores,
integrality, status and gap. With it every named block is computed again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np

from climbplan.errors import UsageError
from climbplan.plans.checks.check import Check
from climbplan.plans.program_plan import Layouts, ProgramPlan
from climbplan.plans.verification import Verification
from climbplan.program.instance import Index
from climbplan.program.polytope import Array
from climbplan.program.problem import Problem

_OBJECTIVE = 1e-6  # relative
_INTEGRALITY = 1e-6


def verify_file(plan: ProgramPlan) -> Verification:
    """What the file says about itself: no statement is needed."""
    return Verification(tuple(_file_checks(plan)))


def verify_program(plan: ProgramPlan, problem: Problem) -> Verification:
    """The file's own checks, then every named block of the statement at every answered row.

    Raises UsageError if the plan's columns are not those of the problem.
    """
    if not plan.layouts.same_columns(Layouts.of(problem.program)):
        raise UsageError(
            f"problem {problem.name!r} does not have the variables and parameters of the plan "
            f"(made for {plan.problem!r})"
        )
    return Verification((*_file_checks(plan), *_block_checks(plan, problem)))


def _file_checks(plan: ProgramPlan) -> Iterator[Check]:
    digest = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    yield _check("file.spec_hash", float(digest != plan.spec_sha256), 0.0)
    found = np.flatnonzero(plan.found)
    for block in plan.layouts.variables:
        here = slice(block.start, block.stop)
        x = plan.x[found, here]
        low, high = plan.layouts.lower[here], plan.layouts.upper[here]
        outside = np.maximum(np.maximum(low - x, x - high), 0.0)
        yield _worst(f"file.bounds.{block.name}", outside, plan.tolerance, block.unit, found)
        if block.integer:
            fraction = np.abs(x - np.round(x))
            yield _worst(f"file.integrality.{block.name}", fraction, _INTEGRALITY, "", found)
    objective, bound = plan.objective[found], plan.bound[found]
    above = np.maximum(bound - objective, 0.0) / np.maximum(np.abs(objective), 1.0)
    yield _worst("file.bound", above, _OBJECTIVE, "relative", found)


def _block_checks(plan: ProgramPlan, problem: Problem) -> Iterator[Check]:
    found = np.flatnonzero(plan.found)
    residuals: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    objectives = []
    for row in found:
        theta = problem.split(plan.parameters[row])
        report = problem.program.check(plan.x[row], theta, plan.assignment[row])
        objectives.append(report.objective)
        for block in report.blocks:
            residuals.setdefault(block.name, []).append(block.residual)
            units[block.name] = block.unit
    for name, values in residuals.items():
        yield _worst(name, np.array(values), plan.tolerance, units[name], found)
    stored = plan.objective[found]
    off = np.abs(np.array(objectives) - stored) / np.maximum(np.abs(stored), 1.0)
    yield _worst("objective", off, _OBJECTIVE, "relative", found)


def _worst(name: str, residual: Array, limit: float, unit: str, rows: Index) -> Check:
    """The largest residual over rows; nothing to check passes."""
    if residual.size == 0:
        return _check(name, 0.0, limit, unit)
    by_row = residual.reshape(len(rows), -1).max(axis=1)
    at = int(np.argmax(by_row))  # NaN counts as the largest
    place = f"row {rows[at]}" if by_row[at] > 0 or np.isnan(by_row[at]) else ""
    return _check(name, float(by_row[at]), limit, unit, place)


def _check(name: str, residual: float, limit: float, unit: str = "", place: str = "") -> Check:
    passed = bool(residual <= limit)
    used = residual / limit if limit else 0.0
    return Check(name, residual, limit, unit, passed, "", place, used)
