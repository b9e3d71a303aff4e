"""Convex sessions: agreement between backends, warm re-solves, infeasibility, valid bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from climbplan.errors import UsageError
from climbplan.program import Instance, Program
from climbplan.solvers.convex.sessions import ConvexBackend, create_session, solve_convex
from climbplan.solvers.highs.instances import solve_highs
from climbplan.solvers.weak_duality import compute_dual_bound

BACKENDS: tuple[ConvexBackend, ...] = ("daqp", "clarabel", "osqp")
TOLERANCE = {"daqp": 1e-7, "clarabel": 1e-7, "osqp": 1e-5}


def program(semidefinite: bool = False) -> Program:
    p = Program("convex")
    goal = p.parameter("goal", (4,))
    x = p.continuous("x", (4,), -1.0, 1.0)
    A = np.random.default_rng(0).normal(size=(4, 3))
    p.between("rows", x @ A, [-0.3, -np.inf, 0.1], [0.3, 0.5, 0.1])
    d = x - goal
    p.minimise("distance", np.sum((d[:2] if semidefinite else d) ** 2) + 0.1 * x[3])
    return p


@pytest.mark.parametrize("semidefinite", [False, True])
@pytest.mark.parametrize("backend", BACKENDS)
def test_sessions_agree_with_highs(backend: ConvexBackend, semidefinite: bool) -> None:
    p = program(semidefinite)
    used = create_session(backend)
    rng = np.random.default_rng(3)
    for _ in range(6):
        instance = p.instantiate({"goal": rng.uniform(-2, 2, 4)})
        result = solve_convex(instance, used, tolerance=TOLERANCE[backend])
        reference = solve_highs(instance)
        assert result.status == "optimal"
        assert result.objective == pytest.approx(reference.objective, abs=1e-5)
        assert reference.objective is not None
        assert result.bound <= reference.objective + 1e-6
        assert reference.bound == pytest.approx(reference.objective, abs=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_bounds_that_open_close_and_cross(backend: ConvexBackend) -> None:
    instance = program().instantiate({"goal": np.ones(4)})
    used = create_session(backend)
    n = instance.size
    fixed = replace(instance, lower=np.array([0.2, -1, -1, -1]), upper=np.array([0.2, 1, 1, 1.0]))
    opened = replace(instance, row_lower=np.full(3, -np.inf), row_upper=np.full(3, np.inf))
    far = replace(instance, row_lower=np.array([50.0, -np.inf, 0.1]), row_upper=np.full(3, 60.0))
    crossed = replace(instance, lower=np.full(n, 2.0))
    for changed in (instance, fixed, opened, far, crossed, instance):
        result = solve_convex(changed, used, tolerance=TOLERANCE[backend])
        if changed is far or changed is crossed:
            assert result.status == "infeasible"
            continue
        assert result.status == "optimal"
        reference = solve_highs(changed)
        assert result.objective == pytest.approx(reference.objective, abs=1e-5)


def test_everything_fixed() -> None:
    instance = program().instantiate({"goal": np.ones(4)})
    free = replace(instance, row_lower=np.full(3, -np.inf), row_upper=np.full(3, np.inf))
    point = np.full(4, 0.25)
    result = solve_convex(replace(free, lower=point, upper=point), "daqp")
    assert result.objective == pytest.approx(free.objective(point))
    wrong = replace(instance, lower=point, upper=point)
    assert solve_convex(wrong, "daqp").status == "infeasible"


def test_weak_dual_is_valid_for_any_multipliers() -> None:
    rng = np.random.default_rng(5)
    instance = program().instantiate({"goal": rng.normal(size=4)})
    best = solve_convex(instance).objective
    assert best is not None
    for _ in range(50):
        assert compute_dual_bound(instance, rng.normal(size=4), rng.normal(size=3)) <= best + 1e-9


def test_balls_only_in_clarabel() -> None:
    p = Program("ball")
    x = p.continuous("x", (1, 2))
    p.ball("near", x, 1.0)
    p.minimise("far", np.sum(x[0] * np.array([1.0, 1.0])))
    result = solve_convex(p.instantiate())
    assert result.status == "optimal"
    assert result.objective == pytest.approx(-np.sqrt(2))
    for backend in ("daqp", "osqp"):
        with pytest.raises(UsageError, match="clarabel"):
            solve_convex(p.instantiate(), backend)


def test_integers_are_refused() -> None:
    p = Program("whole")
    p.binary("z", (1,))
    instance: Instance = p.instantiate()
    with pytest.raises(UsageError, match="integers left"):
        solve_convex(instance)
