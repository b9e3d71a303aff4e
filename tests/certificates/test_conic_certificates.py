"""Bounds of programs with second-order cones: from any multipliers, and with certificates."""

from __future__ import annotations

from dataclasses import replace

import clarabel
import numpy as np
import pytest
from scipy import sparse

from climbplan.certificates.certificate import Certificate
from climbplan.certificates.checker import check
from climbplan.certificates.rows import build_stated_rows
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.conic_relaxation import ConicRelaxation, _NodeProgram
from climbplan.solvers.mixed_integer.outer_approximation import ConicSearch

GAP = 1e-4


def random_cones(seed: int, is_open: bool = False) -> Instance:
    """A regression with switches and integer offsets; every fourth has no feasible point.

    Where it is open, the limit of a cone has no upper bound, and only its cost keeps it small.
    """
    rng = np.random.default_rng([seed, 11])
    n, m = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    p = Program(f"cones{seed}")
    x = p.continuous("x", (n,), -3.0, 3.0)
    z, y = p.binary("z", (n,)), p.integer("y", (m,), -4.0, 4.0)
    t = p.continuous("t", (1,), 0.0, np.inf if is_open else 100.0)
    A, B = rng.normal(size=(n + 2, n)), rng.normal(size=(n + 2, m))
    p.cone("fit", (A @ x + B @ y - 2.0 * rng.normal(size=n + 2))[None], t)
    p.between("upper", x - 3.0 * z, -np.inf, 0.0)
    p.between("lower", x + 3.0 * z, 0.0, np.inf)
    p.between("count", np.array([np.sum(z)]), 0.0, n // 2 + 1)
    centre = rng.normal(size=n) + (5.0 if seed % 4 == 3 else 0.0)
    p.cone("near", (x - centre)[None], np.array([1.5 + 0.1 * np.sum(y)]))
    p.minimise("cost", t[0] + rng.random(n) @ z)
    if seed % 2:
        p.minimise("curved", np.sum((x - 1.0) ** 2))
    return p.instantiate()


@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_searches_of_cones_are_proved(seed: int, is_open: bool) -> None:
    instance = random_cones(seed, is_open)
    search = ConicSearch(GAP, proves=True)
    result = search.solve(instance, 60.0)
    assert search.certificate is not None
    verdict = check(instance, search.certificate)
    assert not verdict.faults
    if result.status == "infeasible":
        assert verdict.bound == np.inf
        assert verdict.margin > 0.0
        return
    assert result.status == "optimal"
    assert result.objective is not None
    scale = max(1.0, abs(result.objective))
    assert verdict.bound <= result.objective + 1e-7 * scale
    assert verdict.bound >= result.objective - 1.01 * GAP * scale


def test_programs_are_of_both_kinds() -> None:
    statuses = {ConicSearch(GAP).solve(random_cones(seed), 60.0).status for seed in range(8)}
    assert statuses == {"optimal", "infeasible"}


def test_a_search_without_end_proves_what_it_has() -> None:
    instance = random_cones(1)
    search = ConicSearch(GAP, proves=True)
    best = search.solve(instance, 60.0)
    early = ConicSearch(GAP, proves=True)
    early.solve(instance, 0.0)
    assert best.objective is not None
    for certificate in (search.certificate, early.certificate):
        assert certificate is not None
        assert check(instance, certificate).bound <= best.objective + 1e-7


@pytest.mark.parametrize("seed", range(6))
def test_any_multipliers_bound_the_relaxation(seed: int) -> None:
    """Weak duality, also with multipliers outside the dual cone and points elsewhere."""
    instance = replace(random_cones(seed), integer=np.zeros(random_cones(seed).size, bool))
    relaxation = ConicRelaxation(instance)
    solution = relaxation.solve(instance.lower, instance.upper)
    exact = relaxation.solve_exactly(instance.lower, instance.upper, 1e-6)
    if exact is None:
        assert solution.status == "infeasible"
        return
    value = instance.objective(exact)
    assert solution.bound <= value + 1e-9
    assert solution.bound >= value - 1e-6 * max(1.0, abs(value))
    program = _NodeProgram(
        P=sparse.csc_matrix(sparse.triu(instance.P)),
        q=instance.q,
        A=sparse.csc_matrix(relaxation._M),
        b=np.where(np.isfinite(relaxation._b), relaxation._b, 0.0),
        num_equal=relaxation._num_equal,
        num_linear=relaxation._num_linear + 2 * instance.size,
        num_bounds=2 * instance.size,
        cone_sizes=relaxation._cone_sizes,
    )
    rng = np.random.default_rng(seed)
    for _ in range(200):
        z, point = rng.normal(size=len(program.b)), rng.normal(size=instance.size)
        bound = program.evaluate(z, point, instance.lower, instance.upper)
        assert bound + instance.constant <= value + 1e-9


def test_a_wrong_claim_of_the_solver_is_not_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """A dual value that multipliers do not prove is no bound, an unproved ray no infeasibility."""
    instance = random_cones(0)
    relaxation = ConicRelaxation(instance)
    honest = relaxation.solve(instance.lower, instance.upper)
    solve = _NodeProgram.solve

    class Claim:
        def __init__(self, answer: object, status: object) -> None:
            self.x, self.z = np.array(answer.x), 0.9 * np.array(answer.z)  # type: ignore[attr-defined]
            self.obj_val_dual, self.status = 1e3, status

    monkeypatch.setattr(
        _NodeProgram, "solve", lambda p, o: Claim(solve(p, o), clarabel.SolverStatus.Solved)
    )
    assert relaxation.solve(instance.lower, instance.upper).bound <= honest.bound + 1e-6
    monkeypatch.setattr(
        _NodeProgram,
        "solve",
        lambda p, o: Claim(solve(p, o), clarabel.SolverStatus.PrimalInfeasible),
    )
    assert relaxation.solve(instance.lower, instance.upper).status != "infeasible"


def fixed_cones(limit: float) -> Instance:
    """Pairs of integers with |(2 a - b, a + b - 1)| <= limit, of which none is below 1."""
    p = Program("fixed cones")
    a, b = p.integer("a", (1,), 0, 2), p.integer("b", (1,), 0, 2)
    p.cone(
        "near", np.array([[2.0 * a[0] - b[0], a[0] + b[0] - 1.0]]), np.array([limit + 0.0 * a[0]])
    )
    p.minimise("cost", a[0] + 3.0 * b[0] + 1.0)
    return p.instantiate()


@pytest.mark.parametrize("limit", [0.9, 1.0, 2.0])
def test_cones_of_fixed_variables_are_judged_and_proved(limit: float) -> None:
    """A node without free variables has a cone program without variables, which no solver takes."""
    instance = fixed_cones(limit)
    points = [np.array([a, b], float) for a in range(3) for b in range(3)]
    costs = [instance.objective(x) for x in points if instance.violation(x) <= 1e-9]
    search = ConicSearch(GAP, proves=True)
    result = search.solve(instance, 60.0)
    assert result.status == ("optimal" if costs else "infeasible")
    assert search.certificate is not None
    verdict = check(instance, search.certificate)
    assert not verdict.faults
    assert verdict.bound == pytest.approx(min(costs, default=np.inf), abs=1e-4)


@pytest.mark.parametrize("width", [1.0, 1e-9, 1e-12])
def test_ranges_of_any_unit_are_searched(width: float) -> None:
    """The capacity of 0.9 of the range is the best one, also where the unit is the farad."""
    p = Program("capacity")
    c, t = p.continuous("c", (1,), 0.0, width)[0], p.continuous("t", (1,), 0.0, 10.0)
    z = p.binary("z", (1,))[0]
    p.cone("near", np.array([[c / width - 0.9, 0.5 * z - 0.5]]), t)
    p.minimise("cost", t[0] + 0.1 * z + 1.0)
    result = ConicSearch(GAP).solve(p.instantiate(), 60.0)
    assert result.status == "optimal"
    assert result.objective == pytest.approx(1.1, abs=1e-4)
    assert result.bound <= 1.1 + 1e-9


def state_cone(constant: float) -> Instance:
    """Return |3 x0 - 2 x1 + 1| <= 2 x0 - 3 x1 + 3 x2 + constant over a box.

    For -3 the limit reaches 0 at one corner only, where the vector is not 0.
    """
    p = Program("corner")
    x = p.continuous("x", (3,), np.array([-2.0, 0.0, 0.0]), np.array([0.0, 1.0, 1.0]))
    vector = np.array([[3.0 * x[0] - 2.0 * x[1] + 1.0]])
    p.cone("cone", vector, np.array([2.0 * x[0] - 3.0 * x[1] + 3.0 * x[2] + constant]))
    p.minimise("cost", x[0] - x[2])
    return p.instantiate()


def test_cones_whose_limit_is_nowhere_positive_are_refuted() -> None:
    instance = state_cone(-3.0)
    search = ConicSearch(GAP, proves=True)
    assert search.solve(instance, 10.0).status == "infeasible"
    assert search.certificate is not None
    assert check(instance, search.certificate).bound == np.inf


@pytest.mark.parametrize("seed", range(4))
def test_any_multiplier_of_a_limit_bounds_feasible_points(seed: int) -> None:
    rng, instance = np.random.default_rng(seed), state_cone(-2.0)
    points = rng.uniform(instance.lower, instance.upper, (50_000, 3))
    vector = points @ (3.0, -2.0, 0.0) + 1.0
    feasible = points[np.abs(vector) <= points @ (2.0, -3.0, 3.0) - 2.0]
    assert len(feasible)
    assert instance.violation(feasible[0]) <= 0.0
    best = float((feasible @ instance.q).min())
    rows = build_stated_rows(instance)
    assert list(np.flatnonzero(np.isfinite(rows.lower) | np.isfinite(rows.upper))) == [0]
    assert (rows.lower[:, None] <= rows.G @ feasible.T).all()
    for _ in range(50):
        certificate = Certificate(
            split=np.array([-1]),
            at=np.zeros(1),
            point=rng.uniform(-1.0, 1.0, (1, 3)),
            multiplier=sparse.csr_matrix(rng.normal(size=(1, 1))),
            ball=rng.normal(size=(1, 1)),
            empty=np.zeros(1, bool),
            bound=0.0,
        )
        assert check(instance, certificate).bound <= best
        assert check(instance, replace(certificate, empty=np.ones(1, bool))).bound < np.inf
