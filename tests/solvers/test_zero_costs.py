"""Optima of zero are proved, and small costs are not mistaken for zero."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from climbplan.program import Problem, Program
from climbplan.solvers.mixed_integer.method import solve_mixed_integer
from climbplan.solvers.mixed_integer.outer_approximation import solve_conic
from climbplan.solvers.result import compute_zero_cost, relative_gap


def _state_linear_cost(seed: int) -> Program:
    """Return a program whose cost is a row that is at least 0, and 0 at some point."""
    rng, program = np.random.default_rng(seed), Program("zero")
    x, z = program.continuous("x", (8,), -4.0, 4.0), program.binary("z", (14,))
    v = np.array([*x, *z], dtype=object)
    point = np.concatenate([rng.uniform(-3.0, 3.0, 8), rng.integers(0, 2, 14)])
    for k in range(6):
        row = rng.integers(-3, 4, 22).astype(float)
        program.between(f"row {k}", np.array([row @ v]), -np.inf, float(row @ point))
    cost = rng.integers(-3, 4, 22).astype(float)
    program.between("cost", np.array([cost @ v]), float(cost @ point), np.inf)
    program.minimise("cost", cost @ v - float(cost @ point))
    return program


@pytest.mark.parametrize("seed", range(3, 6))
def test_an_optimum_of_zero_is_proved_without_enumeration(seed: int) -> None:
    instance = _state_linear_cost(seed).instantiate()
    for result in (solve_mixed_integer(instance), solve_conic(instance)):
        assert result.status == "optimal"
        assert result.gap == 0.0
        assert result.nodes < 100


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("seed", range(4))
def test_small_costs_are_no_zeros(seed: int, unit: float) -> None:
    """The least of all assignments is found in any unit of the cost."""
    rng, program = np.random.default_rng(seed), Program("small")
    z = program.binary("z", (6,))
    row, cost = rng.integers(1, 9, 6).astype(float), rng.integers(1, 9, 6).astype(float)
    program.between("row", np.array([row @ z]), row.sum() / 2.0, np.inf)
    program.minimise("cost", unit * (cost @ z))
    points = np.array(list(itertools.product((0.0, 1.0), repeat=6)))
    best = unit * float((points @ cost)[points @ row >= row.sum() / 2.0].min())
    result = solve_mixed_integer(program.instantiate())
    assert result.status == "optimal"
    assert result.objective == pytest.approx(best, rel=1e-4)


def test_the_least_change_of_any_variable_is_the_scale() -> None:
    program = Program("scales")
    x, y = program.continuous("x", (2,), 0.0, 2000.0), program.binary("y", (1,))
    program.continuous("free", (1,), 0.0, 1.0)
    program.continuous("fixed", (1,), 1.0, 1.0)
    program.minimise("cost", 4.0 * x[0] + (x[1] - 1000.0) ** 2 + 1e-3 * y[0])
    assert compute_zero_cost(Problem("scales", program).program.instantiate()) == pytest.approx(
        1e-9
    )


@pytest.mark.parametrize(
    ("objective", "bound", "zero_cost", "gap"),
    [
        (1e-8, -1e-7, 1e-6, 0.0),
        (1e-8, -1e-7, 1e-9, 11.0),
        (2e-6, 1.5e-6, 1e-6, 0.25),  # no zero: its gap is relative
        (-1e-8, -2e-6, 1e-6, 199.0),
    ],
)
def test_gaps_of_zeros(objective: float, bound: float, zero_cost: float, gap: float) -> None:
    assert relative_gap(objective, bound, zero_cost) == pytest.approx(gap, abs=0.02)
