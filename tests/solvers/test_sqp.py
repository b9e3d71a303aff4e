"""Local SQP at given integers against IPOPT, and what it does with candidates that cannot hold."""

from __future__ import annotations

import numpy as np
import pytest
from bilinear_programs import bilinear, disjunctive
from cart_pole import random_theta
from cart_pole_data import damped, rollout
from small_programs import random_numbers, small_program

from climbplan.errors import UsageError
from climbplan.program import Program
from climbplan.solvers.convex.sessions import ConvexBackend
from climbplan.solvers.ipopt.instances import compute_box_center, solve_fixed_integers
from climbplan.solvers.sqp.elimination import eliminate_equations, multiply_sparse, propagate_fixed
from climbplan.solvers.sqp.envelopes import EnvelopeSolver
from climbplan.solvers.sqp.method import SqpOptions, SqpSolver
from climbplan.solvers.sqp.step import DaqpStepSolver, QuadraticProgram, SessionStepSolver

TIGHT = 1e-5
NONE = np.zeros(0, np.int64)
_DAMPED = damped()


def test_agrees_with_ipopt_on_pinned_cart_poles_with_damping() -> None:
    rng = np.random.default_rng(5)
    touch = _DAMPED.variables["touch"]
    held = dropped = 0
    for _ in range(8):
        theta = random_theta(rng)
        instance = _DAMPED.instantiate(theta)
        solver = SqpSolver(instance)
        for gain in (1.0, 0.0):
            start = rollout(_DAMPED, theta, gain)
            for flip in (-1, 0, 7):
                other_contacts = start.copy()
                if flip >= 0:
                    other_contacts[touch.start + flip] = 1.0 - start[touch.start + flip]
                found = solver.solve(other_contacts, NONE, start)
                other = solve_fixed_integers(instance, other_contacts).v
                if instance.violation(other) <= 1e-6:
                    assert found.feasible
                    assert found.x is not None
                    assert instance.violation(found.x) <= TIGHT
                    assert found.objective <= instance.objective(other) * (1 + 1e-4)
                    held += 1
                else:
                    assert not found.feasible
                    dropped += 1
    assert held >= 10
    assert dropped >= 5


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_ipopt_on_small_bilinear_instances(seed: int) -> None:
    instance = bilinear(seed)
    solver = SqpSolver(instance)
    for bits in ((0.0, 1.0), (1.0, 0.0), (1.0, 1.0)):
        start = compute_box_center(instance)
        start[instance.integer] = bits
        found = solver.solve(start, NONE, start)
        other = solve_fixed_integers(instance, start).v
        reference = instance.objective(other)
        if found.feasible:
            assert found.x is not None
            assert instance.violation(found.x) <= TIGHT
            # Both are local; neither may be far worse than the other here.
            if instance.violation(other) <= 1e-6:
                assert found.objective <= reference + 0.5 * abs(reference) + 0.1


def test_balls_choices_and_products_together() -> None:
    program = small_program(bilinear=True)
    rng = np.random.default_rng(2)
    agreed = 0
    for _ in range(6):
        instance = program.instantiate(random_numbers(rng))
        solver = SqpSolver(instance)
        for mode in range(3):
            for side in range(2):
                start = compute_box_center(instance)
                start[instance.integer] = np.eye(3)[mode]
                chosen = np.array([side])
                found = solver.solve(start, chosen, start)
                other = solve_fixed_integers(instance, start, chosen).v
                if found.feasible:
                    assert found.x is not None
                    assert instance.violation(found.x, chosen) <= TIGHT
                if found.feasible and instance.violation(other, chosen) <= 1e-6:
                    agreed += found.objective == pytest.approx(instance.objective(other), abs=1e-4)
    assert agreed >= 10


@pytest.mark.parametrize("backend", ["daqp", "clarabel", "osqp"])
def test_backends_agree_where_it_is_convex(backend: ConvexBackend) -> None:
    instance = disjunctive(1)
    options = SqpOptions(backend=backend, tolerance=1e-5)
    solver, reference = SqpSolver(instance, options), SqpSolver(instance)
    compared = 0
    for bits in ((1.0, 0, 0), (0.0, 1, 0), (0.0, 0, 1), (1.0, 1, 0)):
        for chosen in np.ndindex(2, 3):
            start = np.zeros(instance.size)
            start[instance.integer] = bits
            best = reference.solve(start, np.array(chosen), start)
            found = solver.solve(start, np.array(chosen), start)
            assert found.feasible == best.feasible
            if best.feasible:
                assert found.objective == pytest.approx(best.objective, abs=1e-3)
                compared += 1
    assert compared


@pytest.mark.parametrize("backend", ["clarabel", "osqp"])
def test_backends_agree_with_products(backend: ConvexBackend) -> None:
    p = Program("corner")
    x = p.continuous("x", (3,), 0.1, 4.0)
    p.equal("product", x[:1] * x[1:2] - 2.0 * x[2:])
    p.between("sum", np.sum(x, keepdims=True), 4.0, 6.0)
    p.minimise("cost", np.sum((x - np.array([3.0, 0.5, 1.0])) ** 2) + x[2])
    instance, start = p.instantiate(), np.array([1.0, 3.0, 1.5])
    best = SqpSolver(instance).solve(start, NONE, start)
    found = SqpSolver(instance, SqpOptions(backend=backend)).solve(start, NONE, start)
    assert best.feasible
    assert found.feasible
    assert found.objective == pytest.approx(best.objective, abs=1e-5)
    reference = instance.objective(solve_fixed_integers(instance, start).v)
    assert best.objective == pytest.approx(reference, abs=1e-5)


def test_multipliers_from_the_gradient_are_those_of_daqp() -> None:
    rng = np.random.default_rng(3)
    compared = 0
    for _ in range(5):
        half, G = rng.normal(size=(4, 4)), rng.normal(size=(6, 4))
        width = rng.uniform(0.0, 0.6, 6)
        problem = QuadraticProgram(
            half @ half.T + np.eye(4),
            3 * rng.normal(size=4),
            np.full(4, -2.0),
            np.full(4, 2.0),
            G,
            -width,
            width,
        )
        exact, other = DaqpStepSolver().solve(problem), SessionStepSolver("clarabel").solve(problem)
        assert exact.d is not None
        assert other.d == pytest.approx(exact.d, abs=1e-6)
        assert other.multipliers == pytest.approx(exact.multipliers, abs=1e-4)
        compared += int((np.abs(exact.multipliers) > 1e-3).sum())
    assert compared


def test_envelopes_hold_products_only_as_well_as_their_box_is_small() -> None:
    p = Program("unit")
    x = p.continuous("x", (2,), -1.0, 1.0)
    z = p.binary("z", (1,))
    p.equal("circle", x[:1] ** 2 + x[1:] ** 2 - 1.0)
    p.when("right", z[0], x[:1], lower=0.0)
    p.minimise("cost", np.sum((x - np.array([1.0, 0.2])) ** 2))
    instance, start = p.instantiate(), np.array([0.8, 0.6, 1.0])
    off = []
    for pieces in (4, 64):
        found = EnvelopeSolver(instance, "clarabel", pieces).solve(start, NONE, start)
        assert found.x is not None
        assert (np.abs(found.x - start) <= 2.0 / pieces + 1e-6).all()
        off.append(instance.violation(found.x))
    assert off[0] > off[1] > 0
    away = EnvelopeSolver(instance, "clarabel", 8).solve(start, NONE, np.array([0.1, 0.1, 1.0]))
    assert away.word == "contradiction"


def test_integers_that_contradict_linear_rows_need_no_step() -> None:
    p = Program("two")
    x = p.continuous("x", (2,), -1.0, 1.0)
    z = p.binary("z", (1,))
    p.when("far", z[0], x[:1] + x[1:], lower=3.0)
    p.equal("circle", x[:1] ** 2 + x[1:] ** 2 - 1.0)
    p.minimise("cost", np.sum(x**2) + x[0])
    instance = p.instantiate()
    solver = SqpSolver(instance)
    start = np.array([0.6, 0.7, 1.0])
    dropped = solver.solve(start, NONE, start)
    assert dropped.ending == "contradiction"
    assert dropped.programs <= 1


def test_a_unit_vector_turns_past_the_axes() -> None:
    p = Program("unit")
    x = p.continuous("x", (2,), -1.0, 1.0)
    p.equal("circle", x[:1] ** 2 + x[1:] ** 2 - 1.0)
    p.minimise("cost", np.sum(x**2) + x[0] - 0.1 * x[1])
    solver = SqpSolver(p.instantiate())
    found = solver.solve(np.zeros(2), NONE, np.array([0.6, 0.7]))
    assert found.feasible
    assert found.x is not None
    assert found.x == pytest.approx(np.array([-1.0, 0.1]) / np.sqrt(1.01), abs=1e-4)


def test_rows_whose_products_contradict_are_dropped_early() -> None:
    p = Program("apart")
    x = p.continuous("x", (2,), 0.1, 2.0)
    p.equal("product", x[:1] * x[1:] - 5.0)
    p.minimise("cost", np.sum(x**2))
    solver = SqpSolver(p.instantiate())
    found = solver.solve(np.ones(2), NONE, np.ones(2))
    assert not found.feasible
    assert found.programs <= 8


def test_cutoff_ends_a_search_that_costs_too_much() -> None:
    p = Program("cut")
    x = p.continuous("x", (2,), 0.1, 4.0)
    p.equal("product", x[:1] * x[1:] - 4.0)
    p.minimise("cost", np.sum(x**2))
    solver = SqpSolver(p.instantiate())
    start = np.array([3.0, 1.0])
    assert solver.solve(start, NONE, start).objective == pytest.approx(8.0, rel=1e-5)
    assert solver.solve(start, NONE, start, cutoff=2.0).ending == "cutoff"


def test_large_instances_are_refused() -> None:
    p = Program("large")
    x = p.continuous("x", (2100,), 0.0, 1.0)
    p.between("rows", x, 0.0, 1.0)
    p.minimise("cost", np.sum(x**2))
    with pytest.raises(UsageError, match="too large"):
        SqpSolver(p.instantiate())


def test_settled_fixes_through_products_and_squares() -> None:
    # x0 = 0.6; x0 x1 = 0.3; x1^2 + x2^2 = 1 with x2 >= 0
    A = np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 0]])
    Q = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 1]])
    first, second = np.array([0, 1, 2]), np.array([1, 1, 2])
    value = np.array([0.6, 0.3, 1.0])
    low, high = np.array([-1.0, -1, 0]), np.ones(3)
    assert propagate_fixed(A, Q, first, second, value, value, low, high)
    assert low == pytest.approx([0.6, 0.5, np.sqrt(0.75)])
    assert (low == high).all()
    low, high = np.array([-1.0, 0.7, 0]), np.ones(3)
    assert not propagate_fixed(A, Q, first, second, value, value, low, high)


def test_elimination_keeps_the_solutions() -> None:
    rng = np.random.default_rng(0)
    E = rng.normal(size=(4, 7))
    E = np.vstack([E, E[0] + E[1]])  # says nothing new
    x = rng.normal(size=7)
    e = E @ x
    F, f, pivot = E.copy(), e.copy(), np.zeros(5, np.int64)
    assert eliminate_equations(F, f, np.ones(7), pivot)
    assert (pivot >= 0).sum() == 4
    assert f == pytest.approx(F @ x)
    wrong = e.copy()
    wrong[4] += 1.0
    assert not eliminate_equations(E.copy(), wrong, np.ones(7), np.zeros(5, np.int64))


def test_thin_product_is_the_product() -> None:
    rng = np.random.default_rng(0)
    left, right = rng.normal(size=(5, 4)), rng.normal(size=(4, 3))
    left[left < 0] = 0.0
    assert multiply_sparse(left, right) == pytest.approx(left @ right)
