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
from climbplan.solvers.result import relative_gap
from climbplan.store.program_plan import Layouts, ProgramPlan
from climbplan.verification.check import Check, LeftOut
from climbplan.verification.held import held_against, held_check
from climbplan.verification.verification import Verification

_OBJECTIVE = 1e-6  # relative
_INTEGRALITY = 1e-6
_NO_BLOCKS = LeftOut("file alone", "the problem's blocks are not looked at without --problem")


def verify_file(plan: ProgramPlan, held: HeldSpec | None = None) -> Verification:
    """What the file says about itself: no statement is needed, and so no block is looked at."""
    checks = tuple(_file_checks(plan, held))
    return Verification(checks, beyond=(_NO_BLOCKS,), against=held_against(plan, held))


def verify_program(
    plan: ProgramPlan, problem: Problem, held: HeldSpec | None = None
) -> Verification:
    """The file's own checks, then every named block of the statement at every answered row.

    held: a spec that the answers are held against in place of their own. Raises UsageError if the
    plan's columns are not those of the problem.
    """
    if not plan.layouts.same_columns(Layouts.of(problem.program)):
        raise UsageError(
            f"problem {problem.name!r} does not have the variables and parameters of the plan "
            f"(made for {plan.problem!r})"
        )
    answer = _answering(plan, held)
    checks = (
        *_file_checks(plan, held),
        *_problem_checks(answer, problem),
        *_block_checks(answer, problem),
    )
    return Verification(checks, against=held_against(plan, held))


def _answering(plan: ProgramPlan, held: HeldSpec | None) -> ProgramPlan:
    """The plan as an answer to another spec."""
    return plan if held is None else replace(plan, spec_text=held.text)


def _file_checks(plan: ProgramPlan, held: HeldSpec | None) -> Iterator[Check]:
    digest = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    yield _check("file.spec_hash", float(digest != plan.spec_sha256), 0.0)
    if held is not None:
        yield held_check(held)
        plan = _answering(plan, held)
    spec = _spec_of(plan)
    yield _spec_values(plan, spec)
    yield _totals(plan)
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
    reached = np.array([relative_gap(f, b) for f, b in zip(objective, bound, strict=True)])
    same = np.isclose(plan.gap[found], reached, 1e-6, 1e-9)
    yield _worst("file.gap", np.where(same, 0.0, np.inf), 0.0, "", found)
    if isinstance(spec, ProgramSpec):
        proved = np.array([plan.status[row] == "optimal" for row in found], bool)
        most = spec.solver.gap + 1e-9
        yield _worst("file.optimal", reached[proved], most, "relative", found[proved])


def _spec_of(plan: ProgramPlan) -> ProgramSpec | str:
    """The validated spec, or what is wrong with it."""
    try:
        spec, findings = validate(parse_yaml(plan.spec_text, "spec"), ProgramSpec)
    except SpecError as error:
        return str(error).splitlines()[0]
    return findings[0].message if spec is None else spec


def _spec_values(plan: ProgramPlan, spec: ProgramSpec | str) -> Check:
    """What the answers are judged by is what the spec says."""
    if isinstance(spec, str):
        return _check("file.spec_values", np.inf, 0.0, "", spec)
    asked = spec.sample.count if spec.sample is not None else len(spec.thetas)
    pairs = {
        "seed": (plan.seed, spec.seed),
        "solver.tolerance": (plan.tolerance, spec.solver.tolerance),
        "rows": (plan.count, asked),
    }
    wrong = [name for name, (stored, meant) in pairs.items() if stored != meant]
    return _check("file.spec_values", float(len(wrong)), 0.0, "", ", ".join(wrong))


def _totals(plan: ProgramPlan) -> Check:
    """What the file says of all rows together follows from the rows."""
    stored, wrong = plan.stored_totals, []
    if stored is not None:
        for name, meant in vars(plan.totals).items():
            value = vars(stored)[name]
            numbers = isinstance(value, float) and isinstance(meant, float)
            if not (np.isclose(value, meant, 1e-9, 1e-12) if numbers else value == meant):
                wrong.append(name)
    return _check("file.totals", float(len(wrong)), 0.0, "", ", ".join(wrong))


def _problem_checks(plan: ProgramPlan, problem: Problem) -> Iterator[Check]:
    """Bounds of x and parameters are those of the statement and the spec."""
    meant = Layouts.of(problem.program)
    same = np.array_equal(plan.layouts.lower, meant.lower)
    same = same and np.array_equal(plan.layouts.upper, meant.upper)
    yield _check("file.layouts", float(not same), 0.0)
    spec = _spec_of(plan)
    if isinstance(spec, ProgramSpec) and spec.theta is not None:
        pairs = zip(spec.thetas, plan.parameters, strict=False)  # file.spec_values counts rows
        off = [float(not _same_numbers(problem, given, stored)) for given, stored in pairs]
        yield _worst("file.parameters", np.array(off), 0.0, "", np.arange(len(off)))


def _same_numbers(problem: Problem, given: Mapping[str, Values], stored: Array) -> bool:
    try:
        written = problem.numbers({name: np.array(value) for name, value in given.items()})
    except (UsageError, ValueError):  # ValueError: ragged lists
        return False
    return bool(np.array_equal(problem.program.theta(written), stored))


def _block_checks(plan: ProgramPlan, problem: Problem) -> Iterator[Check]:
    found = np.flatnonzero(plan.found)
    residuals: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    objectives = []
    for row in found:
        theta = problem.split(plan.parameters[row])
        report = problem.program.check(plan.x[row], theta, plan.assignment[row])
        objectives.append(report.objective)
        for block in (*report.blocks, *problem.own_residuals(theta, plan.x[row])):
            residuals.setdefault(block.name, []).append(block.residual)
            units[block.name] = block.unit
    for name, values in residuals.items():
        yield _worst(name, np.array(values), plan.tolerance, units[name], found)
    stored = plan.objective[found]
    off = np.abs(np.array(objectives) - stored) / np.maximum(np.abs(stored), 1.0)
    yield _worst("objective", off, _OBJECTIVE, "relative", found)


def _worst(name: str, residual: Array, limit: float, unit: str, rows: IntArray) -> Check:
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
