"""Solvers keep their time limits, also where compiled code does not look at the clock."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from test_highs import knapsack

from climbplan.errors import LimitReached
from climbplan.methods.envelope_rounds import EnvelopeOptions
from climbplan.methods.table import solve_instance
from climbplan.methods.task import MethodSettings
from climbplan.program import Problem, Program
from climbplan.reformulations.mccormick import McCormick
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers import interruption
from climbplan.solvers.highs import instances
from climbplan.solvers.highs.model import (
    SolverAbandoned,
    build_linear_model,
    create_highs,
    run_highs,
)
from climbplan.solvers.interruption import has_abandoned_solver, run_in_thread
from climbplan.solvers.ipopt.instances import solve_nlp


@pytest.fixture(autouse=True)
def _no_solver_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interruption, "_num_left", 0)


def test_a_solver_that_heeds_its_deadline_is_waited_for() -> None:
    stopped = threading.Event()
    begin = time.monotonic()
    assert run_in_thread(lambda: stopped.wait(5.0), stopped.set, deadline=begin + 0.1)
    assert stopped.is_set()
    assert time.monotonic() - begin < 2.0
    assert not has_abandoned_solver()


def test_a_solver_that_does_not_is_left_behind() -> None:
    released = threading.Event()
    begin = time.monotonic()
    try:
        assert not run_in_thread(lambda: released.wait(5.0), lambda: None, deadline=begin + 0.1)
        assert time.monotonic() - begin < 2.0
        assert has_abandoned_solver()
        done: list[int] = []
        assert run_in_thread(
            lambda: done.append(1), lambda: None
        )  # the next one has its own thread
        assert done == [1]
    finally:
        released.set()


def test_a_search_of_highs_that_does_not_stop_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = create_highs(0.05)
    one = sparse.csr_matrix(np.ones((1, 1)))
    solver.passModel(
        build_linear_model(
            np.ones(1),
            one,
            lower=np.zeros(1),
            upper=np.ones(1),
            integer=np.ones(1, bool),
            row_lower=np.array([0.5]),
            row_upper=np.array([2.0]),
        )
    )
    assert run_highs(solver, deadline=time.monotonic() + 5.0) is not None
    released = threading.Event()
    monkeypatch.setattr(solver, "run", lambda: released.wait(5.0))
    try:
        with pytest.raises(SolverAbandoned) as caught:
            run_highs(solver, deadline=time.monotonic() + 0.05)
        assert isinstance(caught.value, LimitReached)
        assert caught.value.x is None
    finally:
        released.set()


def test_the_incumbent_of_a_search_that_was_left_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    instance = knapsack(3, False)
    whole = instances.solve_highs(instance)
    assert whole.x is not None

    def behind(solver: object, **_: object) -> None:
        raise SolverAbandoned(whole.x, whole.bound - 1.0)

    monkeypatch.setattr(instances, "run_highs", behind)
    found = instances.solve_highs(instance, time_limit=1.0)
    assert found.status == "feasible"
    assert found.objective == pytest.approx(whole.objective)
    assert found.bound == pytest.approx(whole.bound - 1.0)

    def nothing(solver: object, **_: object) -> None:
        raise SolverAbandoned(None, -np.inf)

    monkeypatch.setattr(instances, "run_highs", nothing)
    assert instances.solve_highs(instance, time_limit=1.0).status == "limit"


def test_nothing_is_built_for_ipopt_after_its_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    def unbuilt(*_: object) -> None:
        raise AssertionError("a program was built")

    monkeypatch.setattr("climbplan.solvers.ipopt.instances._compile_program", unbuilt)
    bounds = Bounds(np.zeros(2), np.ones(2), np.zeros(0), np.zeros(0))
    past = time.monotonic() - 1.0
    point = solve_nlp(None, np.zeros(0), bounds, np.array([-1.0, 0.5]), past)  # type: ignore[arg-type]
    assert point.v.tolist() == [0.0, 0.5]
    assert not point.success


def test_envelopes_that_take_long_to_make_end_with_the_time() -> None:
    program = Program("product")
    x = program.continuous("x", (2,), 0.0, 1.0)
    program.between("product", np.array([x[0] * x[1]]), 0.25, 1.0)
    program.minimise("sum", x.sum())
    problem = Problem("product", program)
    grid = McCormick.on({0: [[0.0, 0.5], [0.5, 1.0]]})
    with pytest.raises(LimitReached, match="before the envelopes were built"):
        grid.form(problem.instance({}), lambda: True)
    settings = MethodSettings(time_limit=0.0, envelopes=EnvelopeOptions(grid=grid))
    late = solve_instance(problem, {}, "mccormick", settings)
    assert (late.result.status, late.result.x) == ("limit", None)
    assert (
        solve_instance(problem, {}, "mccormick", replace(settings, time_limit=20.0)).result.x
        is not None
    )
