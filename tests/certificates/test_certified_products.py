"""Certificates of problems with products: leaves of integers and boxes of factors."""

from __future__ import annotations

import numpy as np
import pytest
from certified_programs import PRODUCTS_GAP, certified_products

import climbplan
from benchmarks.engine.bilinear import planar_push, turning_flyer
from climbplan.certificates.checker import check
from climbplan.methods.sequence import ProblemSequence
from climbplan.methods.task import MethodSettings
from climbplan.program import Problem, Program
from climbplan.solvers.mixed_integer.spatial_method import WarmStartedSpatialTree


@pytest.mark.parametrize("seed", [*range(8), 16, 18])
def test_random_programs_with_products_are_proved(seed: int) -> None:
    _holds_with_products(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 200))
def test_many_random_programs_with_products_are_proved(seed: int) -> None:
    _holds_with_products(seed)


def _holds_with_products(seed: int) -> None:
    instance, found, certificate = certified_products(seed)
    verdict = check(instance, certificate)
    assert not verdict.faults
    if found.status == "infeasible":
        assert verdict.bound == np.inf
        return
    assert found.objective is not None
    scale = 1.0 + abs(found.objective)
    assert verdict.bound <= found.objective + 1e-5 * scale  # answers may violate rows by 1e-6
    assert verdict.bound >= found.bound - PRODUCTS_GAP * scale
    assert verdict.bound >= found.objective - 1.01 * PRODUCTS_GAP * scale


@pytest.mark.parametrize("problem", [turning_flyer(2), planar_push(2)])
def test_user_problems_with_products_are_proved(problem: Problem) -> None:
    theta = problem.sample_parameters(np.random.default_rng(0))
    found = climbplan.solve(problem, theta, gap=1e-3, certificate=True)
    assert found.status == "optimal"
    assert found.certificate is not None
    assert found.objective is not None
    bound = check(problem.instance(theta), found.certificate).bound
    assert found.objective * (1.0 - 1.01e-3) <= bound <= found.objective * (1.0 + 1e-6)


def test_a_product_in_few_rows_is_proved() -> None:
    p = Program("few rows")
    x, z = p.continuous("x", (2,), -1.0, 1.0), p.binary("z", (2,))
    p.when("right", z[0], x[:1], lower=0.2)
    p.when("left", z[0], x[:1], upper=0.1, value=False)
    p.between("one", np.array([z[0] + z[1]]), 1.0, 1.0)
    p.between("product", np.array([x[0] * x[1]]), -0.2, 0.2)
    p.minimise("cost", np.sum((x - np.array([0.15, 0.7])) ** 2))
    instance = p.instantiate()
    tree = WarmStartedSpatialTree(1e-6, 1e-6, proves=True)
    found = tree.solve(instance, 60.0)
    assert tree.certificate is not None
    # x = (0.1, 0.7) with z[0] = 0, and (0.2, 0.7) with z[0] = 1
    assert found.objective == pytest.approx(0.0025, abs=1e-6)
    assert check(instance, tree.certificate).bound == pytest.approx(0.0025, abs=1e-5)


def test_each_answer_of_a_sequence_with_products_is_proved() -> None:
    problem, rng = planar_push(2), np.random.default_rng(0)
    sequence = ProblemSequence(problem, MethodSettings(gap=1e-3, certificate=True))
    for _ in range(2):
        theta = problem.sample_parameters(rng)
        found = sequence.solve(theta)
        assert found.certificate is not None
        assert found.result.objective is not None
        bound = check(problem.instance(theta), found.certificate).bound
        assert found.result.objective * (1.0 - 1.01e-3) <= bound


def test_products_beyond_a_limit_of_nodes_keep_a_valid_bound() -> None:
    problem = planar_push(2)
    instance = problem.instance(problem.sample_parameters(np.random.default_rng(1)))
    tree = WarmStartedSpatialTree(1e-3, 1e-6, proves=True)
    found = tree.solve(instance, 60.0, nodes=16)
    assert tree.certificate is not None
    assert found.objective is not None
    bound = check(instance, tree.certificate).bound
    assert -np.inf < bound <= found.objective
    assert bound >= found.bound - 1e-6 * abs(found.bound)
