"""Verification of answers to a stated program.

Without the statement only the file itself can be checked: its text, the bounds that it stores,
integrality, status and gap. With it every named block is computed again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import SpecError, UsageError
from climbplan.program.problem import Problem
from climbplan.schema.holding import HeldSpec
from climbplan.schema.kinds import validate
from climbplan.schema.program.model import ProgramSpec, Values
from climbplan.schema.yaml_source import parse_yaml
from climbplan.solvers.result import (
    MAX_ZERO_COST,
    MIN_OBJECTIVE_SCALE,
    ROUNDING,
    compute_zero_cost,
    relative_gap,
)
from climbplan.store.program_plan import Layouts, ProgramPlan
from climbplan.verification.check import Check, LeftOut
from climbplan.verification.held import check_spec_differences, describe_reference
from climbplan.verification.verification import Verification

_OBJECTIVE = 1e-6  # relative
_INTEGRALITY = 1e-6
_NO_BLOCKS = LeftOut("file alone", "the problem's blocks are not looked at without --problem")


def verify_file(plan: ProgramPlan, user_spec: HeldSpec | None = None) -> Verification:
    """Verify the file by itself; no block is evaluated, because that needs the statement."""
    checks = tuple(_check_file(plan, user_spec))
    against = describe_reference(plan, user_spec)
    return Verification(checks, beyond=(_NO_BLOCKS,), against=against, is_motion=False)


def verify_program(
    plan: ProgramPlan, problem: Problem, user_spec: HeldSpec | None = None
) -> Verification:
    """Return the file's own checks, then every named block of the statement at every answered row.

    held: a spec that the answers are held against in place of their own. Raises UsageError if the
    plan's columns are not those of the problem.
    """
    if not plan.layouts.same_columns(Layouts.of(problem.program)):
        raise UsageError(
            f"problem {problem.name!r} does not have the variables and parameters of the plan "
            f"(made for {plan.problem!r})"
        )
    answer = _replace_spec(plan, user_spec)
    checks = (
        *_check_file(plan, user_spec, problem),
        *_check_problem(answer, problem),
        *_check_blocks(answer, problem),
    )
    return Verification(checks, against=describe_reference(plan, user_spec), is_motion=False)


def _replace_spec(plan: ProgramPlan, user_spec: HeldSpec | None) -> ProgramPlan:
    """Return the plan as an answer to another spec."""
    return plan if user_spec is None else replace(plan, spec_text=user_spec.text)


def _check_file(
    plan: ProgramPlan, user_spec: HeldSpec | None, problem: Problem | None = None
) -> Iterator[Check]:
    digest = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    yield _build_check("file.spec_hash", float(digest != plan.spec_sha256), 0.0)
    if user_spec is not None:
        yield check_spec_differences(user_spec)
        plan = _replace_spec(plan, user_spec)
    spec = _parse_spec(plan)
    yield _check_spec_values(plan, spec)
    yield _check_totals(plan)
    answered_rows = np.flatnonzero(plan.found)
    for block in plan.layouts.variables:
        columns = slice(block.start, block.stop)
        x = plan.x[answered_rows, columns]
        low, high = plan.layouts.lower[columns], plan.layouts.upper[columns]
        outside = np.maximum(np.maximum(low - x, x - high), 0.0)
        yield _check_worst(
            f"file.bounds.{block.name}", outside, plan.tolerance, block.unit, answered_rows
        )
        if block.integer:
            fraction = np.abs(x - np.round(x))
            yield _check_worst(
                f"file.integrality.{block.name}", fraction, _INTEGRALITY, "", answered_rows
            )
    objective, bound = plan.objective[answered_rows], plan.bound[answered_rows]
    above = np.maximum(bound - objective, 0.0) / np.maximum(np.abs(objective), 1.0)
    yield _check_worst("solution.bound", above, _OBJECTIVE, "relative", answered_rows)
    zero_cost = [_find_zero_cost(plan, row, problem) for row in map(int, answered_rows)]
    triples = list(zip(objective, bound, zero_cost, strict=True))
    reached = np.array([relative_gap(f, b, zero) for f, b, zero in triples])
    if_no_zero = np.array([relative_gap(f, b) for f, b, _ in triples])
    rounding = 1e-9 + ROUNDING / np.maximum(np.abs(objective), MIN_OBJECTIVE_SCALE)
    stored = plan.gap[answered_rows]
    same = np.isclose(stored, reached, 1e-6, rounding) | np.isclose(
        stored, if_no_zero, 1e-6, rounding
    )
    yield _check_worst("file.gap", np.where(same, 0.0, np.inf), 0.0, "", answered_rows)
    if isinstance(spec, ProgramSpec):
        proved = np.array([plan.status[row] == "optimal" for row in answered_rows], bool)
        max_gap = spec.solver.gap + 1e-9
        yield _check_worst(
            "solution.gap", reached[proved], max_gap, "relative", answered_rows[proved]
        )


def _find_zero_cost(plan: ProgramPlan, row: int, problem: Problem | None) -> float:
    """Return the largest cost that counts as zero in a row; without the statement its limit."""
    if problem is None or abs(plan.objective[row]) > MAX_ZERO_COST:
        return MAX_ZERO_COST
    return compute_zero_cost(problem.instance(problem.split(plan.parameters[row])))


def _parse_spec(plan: ProgramPlan) -> ProgramSpec | str:
    """Return the validated spec, or what is wrong with it."""
    try:
        spec, findings = validate(parse_yaml(plan.spec_text, "spec"), ProgramSpec)
    except SpecError as error:
        return str(error).splitlines()[0]
    return findings[0].message if spec is None else spec


def _check_spec_values(plan: ProgramPlan, spec: ProgramSpec | str) -> Check:
    """Return what the answers are judged by is what the spec says."""
    if isinstance(spec, str):
        return _build_check("file.spec_values", np.inf, 0.0, "", spec)
    num_expected = spec.sample.count if spec.sample is not None else len(spec.thetas)
    pairs = {
        "seed": (plan.seed, spec.seed),
        "solver.tolerance": (plan.tolerance, spec.solver.tolerance),
        "rows": (plan.count, num_expected),
    }
    wrong = [name for name, (stored, expected) in pairs.items() if stored != expected]
    return _build_check("file.spec_values", float(len(wrong)), 0.0, "", ", ".join(wrong))


def _check_totals(plan: ProgramPlan) -> Check:
    """Return what the file says of all rows together follows from the rows."""
    stored, wrong = plan.stored_totals, []
    if stored is not None:
        for name, expected in vars(plan.totals).items():
            value = vars(stored)[name]
            numbers = isinstance(value, float) and isinstance(expected, float)
            if not (np.isclose(value, expected, 1e-9, 1e-12) if numbers else value == expected):
                wrong.append(name)
    return _build_check("file.totals", float(len(wrong)), 0.0, "", ", ".join(wrong))


def _check_problem(plan: ProgramPlan, problem: Problem) -> Iterator[Check]:
    """Yield bounds of x and parameters are those of the statement and the spec."""
    expected_layouts = Layouts.of(problem.program)
    same = np.array_equal(plan.layouts.lower, expected_layouts.lower)
    same = same and np.array_equal(plan.layouts.upper, expected_layouts.upper)
    yield _build_check("file.layouts", float(not same), 0.0)
    spec = _parse_spec(plan)
    if isinstance(spec, ProgramSpec) and spec.theta is not None:
        pairs = zip(spec.thetas, plan.parameters, strict=False)  # file.spec_values counts rows
        mismatches = [
            float(not _is_same_theta(problem, stated, stored)) for stated, stored in pairs
        ]
        yield _check_worst(
            "file.parameters", np.array(mismatches), 0.0, "", np.arange(len(mismatches))
        )


def _is_same_theta(problem: Problem, stated: Mapping[str, Values], stored: Array) -> bool:
    try:
        numbers = problem.numbers({name: np.array(value) for name, value in stated.items()})
    except (UsageError, ValueError):  # ValueError: ragged lists
        return False
    return bool(np.array_equal(problem.program.theta(numbers), stored))


def _check_blocks(plan: ProgramPlan, problem: Problem) -> Iterator[Check]:
    answered_rows = np.flatnonzero(plan.found)
    residuals: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    objectives = []
    for row in answered_rows:
        theta = problem.split(plan.parameters[row])
        report = problem.program.check(plan.x[row], theta, plan.assignment[row])
        objectives.append(report.objective)
        for block in (*report.blocks, *problem.own_residuals(theta, plan.x[row])):
            residuals.setdefault(block.name, []).append(block.residual)
            units[block.name] = block.unit
    for name, values in residuals.items():
        yield _check_worst(name, np.array(values), plan.tolerance, units[name], answered_rows)
    stored = plan.objective[answered_rows]
    deviation = np.abs(np.array(objectives) - stored) / np.maximum(np.abs(stored), 1.0)
    yield _check_worst("file.objective", deviation, _OBJECTIVE, "relative", answered_rows)


def _check_worst(name: str, residual: Array, limit: float, unit: str, rows: IntArray) -> Check:
    """Return the largest residual over rows; nothing to check passes."""
    if residual.size == 0:
        return _build_check(name, 0.0, limit, unit)
    by_row = residual.reshape(len(rows), -1).max(axis=1)
    worst_row = int(np.argmax(by_row))  # NaN counts as the largest
    place = f"row {rows[worst_row]}" if by_row[worst_row] > 0 or np.isnan(by_row[worst_row]) else ""
    return _build_check(name, float(by_row[worst_row]), limit, unit, place)


def _build_check(
    name: str, residual: float, limit: float, unit: str = "", place: str = ""
) -> Check:
    passed = bool(residual <= limit)
    used_fraction = residual / limit if limit else 0.0
    return Check(name, residual, limit, unit, passed, "", place, used_fraction)
