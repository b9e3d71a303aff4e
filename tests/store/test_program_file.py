"""Plan files of stated programs: exact round trip, and nothing wrong is read as right."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.errors import PlanFileError, UsageError
from climbplan.program import Problem, Program
from climbplan.store.plan_format import read_plan_format
from climbplan.store.program_file import read_program, write_program
from climbplan.store.program_plan import Layouts, ProgramPlan, combine_statuses
from climbplan.verification.programs import verify_file, verify_program

SPEC = """kind: program
theta: [{at: [1.0, 0.75]}, {at: [9.0, 0.0]}]
seed: 3
"""


def stated() -> Problem:
    p = Program("line")
    at = p.parameter("at", (2,))
    x = p.continuous("x", (2,), -1.0, 4.0, unit="m")
    z = p.binary("z", (1,))
    p.equal("place", x - at, unit="m")
    p.when("up", z[0], x[1], lower=0.5, unit="m")
    p.minimise("cost", x[0] ** 2 + 2 * z[0])
    return Problem("line", p)


def example() -> ProgramPlan:
    nan = np.nan
    return ProgramPlan(
        problem="line",
        layouts=Layouts.of(stated().program),
        parameters=np.array([[1.0, 0.75], [9.0, 0.0]]),
        features=np.array([[1.0, 0.75], [9.0, 0.0]]),
        x=np.array([[1.0, 0.75, 1.0], [nan, nan, nan]]),
        assignment=np.zeros((2, 0), np.int64),
        found=np.array([True, False]),
        status=("optimal", "infeasible"),
        objective=np.array([3.0, nan]),
        bound=np.array([3.0, np.inf]),
        gap=np.array([0.0, nan]),
        time=np.array([0.1, 0.2]),
        method=("mccormick", "mccormick"),
        winner=("envelopes (highs)", ""),
        tried=np.array([1, 1]),
        name="line",
        spec_text=SPEC,
        spec_sha256=hashlib.sha256(SPEC.encode()).hexdigest(),
        seed=3,
        tolerance=1e-6,
        created="2025-01-01T00:00:00+00:00",
        climbplan_version="0.1.0",
    )


def test_round_trip(tmp_path: Path) -> None:
    plan, path = example(), tmp_path / "plan.h5"
    write_program(plan, path)
    assert read_plan_format(path) == "climbplan/program"
    back = read_program(path)
    for name, value in vars(plan).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(vars(back)[name], value, err_msg=name)
        elif name not in ("layouts", "stored_totals"):
            assert vars(back)[name] == value, name
    assert back.layouts.same_columns(plan.layouts)
    with h5py.File(path) as file:
        assert file.attrs["status"] == "limit"
        assert "objective" not in file.attrs  # a row has none
        assert {"format_version", "seed", "verified", "spec_sha256", "created"} <= set(file.attrs)
        assert all("units" in dataset.attrs for dataset in file.values())


def test_one_status_for_all_rows() -> None:
    assert combine_statuses(["optimal", "optimal"]) == "optimal"
    assert combine_statuses(["optimal", "feasible"]) == "feasible"
    assert combine_statuses(["infeasible"]) == "infeasible"
    assert combine_statuses(["optimal", "infeasible"]) == "limit"


def test_verification_with_and_without_the_statement() -> None:
    plan = example()
    assert verify_file(plan).passed
    whole = verify_program(plan, stated())
    assert whole.passed
    names = {check.name for check in whole.checks}
    assert {"place", "up", "bounds.x", "integrality.z", "file.objective", "solution.bound"} <= names


@pytest.mark.parametrize(
    ("change", "failed"),
    [
        (lambda p: replace(p, x=p.x + np.array([[0.01, 0, 0]])), {"place", "file.objective"}),
        (lambda p: replace(p, x=p.x + np.array([[0, 0, -0.3]])), {"integrality.z"}),
        (lambda p: replace(p, objective=p.objective + 1), {"file.objective"}),
        (lambda p: replace(p, bound=p.bound + 1), {"solution.bound"}),
        (lambda p: replace(p, parameters=p.parameters - 0.5), {"place"}),
        (lambda p: replace(p, spec_text="kind: other\n"), {"file.spec_hash", "file.spec_values"}),
        (lambda p: replace(p, tolerance=0.1), {"file.spec_values"}),
        (lambda p: replace(p, seed=4), {"file.spec_values"}),
        (lambda p: replace(p, bound=p.bound - 1), {"file.gap", "solution.gap"}),
        (lambda p: replace(p, gap=p.gap + 0.1), {"file.gap"}),
        (
            lambda p: replace(p, parameters=p.parameters + np.array([[0.0], [1.0]])),
            {"file.parameters"},
        ),
        (
            lambda p: replace(p, layouts=replace(p.layouts, upper=p.layouts.upper + 1)),
            {"file.layouts"},
        ),
    ],
)
def test_tampered_plans_fail(
    change: Callable[[ProgramPlan], ProgramPlan], failed: set[str]
) -> None:
    verification = verify_program(change(example()), stated())
    assert failed <= {check.name for check in verification.failed}


@pytest.mark.parametrize(
    ("name", "value"), [("status", "optimal"), ("objective", 2.0), ("bound", 1.0), ("gap", 0.5)]
)
def test_tampered_totals_fail(tmp_path: Path, name: str, value: float | str) -> None:
    path = tmp_path / "plan.h5"
    write_program(example(), path)
    assert verify_file(read_program(path)).passed
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value
    failed = verify_file(read_program(path)).failed
    assert [check.name for check in failed] == ["file.totals"]


def test_another_statement_is_refused() -> None:
    p = Program("line")
    p.continuous("y", (3,))
    with pytest.raises(UsageError, match="does not have the variables"):
        verify_program(example(), Problem("line", p))


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        (lambda f: f.attrs.create("format", "climbplan/climb"), "not a plan file of"),
        (lambda f: f.attrs.create("format_version", 2), "format version 2"),
        (lambda f: f["x"].__setitem__((0, 1), np.nan), "NaN in x"),
        (lambda f: f["parameters"].__setitem__((1, 1), np.nan), "NaN in parameters"),
        (lambda f: f["found"].__setitem__(1, True), "disagree|NaN"),
        (lambda f: f["status"].__setitem__(0, "splendid"), "status 'splendid'"),
        (lambda f: f.__delitem__("winner"), "winner is missing"),
        (lambda f: f.attrs.create("variable_blocks", "[]"), "columns, its blocks have 0"),
        (lambda f: f.attrs.create("variable_blocks", "3"), "not a list of blocks"),
        (lambda f: f.attrs.create("parameter_blocks", '[{"name": "at"}]'), "shape is None"),
    ],
)
def test_damaged_files(tmp_path: Path, change: Callable[[h5py.File], None], fragment: str) -> None:
    path = tmp_path / "plan.h5"
    write_program(example(), path)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(PlanFileError, match=fragment):
        read_program(path)
