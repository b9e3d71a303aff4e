"""The ADMM split: blocks are what they should be, residuals fall, answers pass the check."""

from __future__ import annotations

import numpy as np
import pytest
from cart_pole import cart_pole, random_theta
from scip_oracle import scip_optimum
from small_programs import TOLERANCE, random_numbers, small_program

from climbplan.reformulations.admm import AdmmSplit
from climbplan.reformulations.nlp_form import Consensus
from climbplan.solvers.admm import AdmmOptions, solve_admm
from climbplan.solvers.ipopt.instances import solve_fixed_integers


def test_envelopes_contain_the_products() -> None:
    instance = small_program(True).instantiate(random_numbers(np.random.default_rng(0)))
    relaxed = AdmmSplit().relax(instance).instance
    assert relaxed.products.count == 0
    rng = np.random.default_rng(1)
    count = instance.A.shape[0]
    for _ in range(200):
        x = rng.uniform(instance.lower, instance.upper)
        w = instance.products.values(x)
        lifted = np.concatenate([x, w])
        row = relaxed.A @ lifted
        assert (row[count:] >= relaxed.row_lower[count:] - 1e-9).all()
        assert (row[count:] <= relaxed.row_upper[count:] + 1e-9).all()
        np.testing.assert_allclose(row[:count], instance.A @ x + instance.Q @ w)
        assert relaxed.objective(lifted) == pytest.approx(instance.objective(x))


@pytest.mark.parametrize("norm", ["l1", "l2"])
def test_consensus_terms(norm: str) -> None:
    instance = cart_pole(0.1).instantiate(random_theta(np.random.default_rng(0)))
    split = AdmmSplit().apply(instance)
    rng = np.random.default_rng(2)
    n = instance.size
    weight, target = rng.uniform(0, 2, n), rng.uniform(-1, 1, n)
    weight[::3] = 0.0
    block = split.build_mixed_integer_block(Consensus(weight, target, 0.5), norm)  # type: ignore[arg-type]
    x = rng.uniform(-1, 1, split.relaxed.instance.size)
    gone = x[:n] - target
    distance = np.abs(gone[weight > 0]) if norm == "l1" else np.zeros(0)
    expected = 0.5 * instance.objective(x[:n])
    expected += weight @ (np.abs(gone) if norm == "l1" else gone**2)
    full = np.concatenate([x, distance])
    assert block.objective(full) == pytest.approx(expected)
    rows = slice(split.relaxed.instance.A.shape[0], None)
    assert (block.A[rows] @ full >= block.row_lower[rows] - 1e-9).all()


def test_residuals_fall_and_the_best_iterate_is_finished() -> None:
    p = cart_pole(0.1)
    theta = random_theta(np.random.default_rng(1))
    instance = p.instantiate(theta)
    options = AdmmOptions(iterations=8, freeze_after=1)
    answer = solve_admm(instance, scip_optimum, options=options)
    residual = [step.mean_residual for step in answer.steps]
    assert residual[-1] < 0.8 * residual[0]
    assert answer.best is not None
    violations = [step.violation for step in answer.steps]
    assert violations[answer.best] == min(violations)
    assert answer.result.x is not None
    assert p.check(answer.result.x, theta).passed(TOLERANCE)
    assert not any(step.new_integers for step in answer.steps[1:])


@pytest.mark.slow
def test_small_bilinear_programs() -> None:
    p = small_program(True)
    near = 0
    for seed in range(8):
        theta = random_numbers(np.random.default_rng(seed))
        instance = p.instantiate(theta)
        exact = scip_optimum(instance)
        assert exact is not None
        best = instance.objective(solve_fixed_integers(instance, exact).v)
        answer = solve_admm(instance, scip_optimum, options=AdmmOptions(iterations=10)).result
        assert answer.x is not None
        assert p.check(answer.x, theta, answer.assignment).passed(TOLERANCE)
        assert answer.objective >= best - 1e-4
        near += answer.objective <= 1.1 * best + 1e-2
    assert near >= 4  # a local method: the integers are often, not always, the best ones


def test_a_mixed_integer_block_without_an_answer_ends_it() -> None:
    instance = small_program(True).instantiate(random_numbers(np.random.default_rng(0)))
    answer = solve_admm(instance, lambda block: None)
    assert answer.steps == ()
    assert answer.result.status == "limit"
    assert answer.result.x is None
