"""Pinned instances: what is left, whether it agrees, and that only numbers change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bilinear_programs import bilinear, disjunctive

from climbplan.errors import UsageError
from climbplan.program import Instance, Program
from climbplan.reformulations.fixed_integers import FixedIntegerForm, FixedIntegers


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("compact", [True, False])
@pytest.mark.parametrize("make", [disjunctive, bilinear])
def test_agrees_with_the_statement_at_the_same_integers(
    make: Callable[[int], Instance], seed: int, compact: bool
) -> None:
    instance = make(seed)
    rng = np.random.default_rng(seed)
    for _ in range(50):
        x = rng.uniform(instance.lower, instance.upper)
        x[instance.integer] = rng.integers(0, 2, int(instance.integer.sum()))
        chosen = np.array([rng.integers(len(c.alternatives)) for c in instance.choices], np.int64)
        pinned = FixedIntegers(x, chosen, compact).apply(instance).instance
        assert not pinned.features - {"products"}
        assert pinned.violation(x) == pytest.approx(instance.violation(x, chosen))
        assert pinned.objective(x) == pytest.approx(instance.objective(x))


def test_only_bounds_change() -> None:
    instance = disjunctive(0)
    form = FixedIntegerForm.of(instance)
    zero = np.zeros(instance.size)
    one = np.where(instance.integer, 1.0, 0.0)
    first = form.at(zero, np.array([0, 0]))
    second = form.at(one, np.array([1, 2]))
    assert first.A is second.A
    assert (first.row_upper != second.row_upper).any()


def test_products_with_a_pinned_factor_become_linear() -> None:
    p = Program("mixed")
    x = p.continuous("x", (2,), -1.0, 1.0)
    z = p.binary("z", (1,))
    p.between("rows", x[:1] * z + 2 * z * z + x[:1] * x[1:] - x[1:], -1.0, 1.0)
    instance = p.instantiate()
    for bit in (0.0, 1.0):
        at = np.array([0.3, -0.4, bit])
        pinned = FixedIntegerForm.of(instance).at(at)
        assert pinned.products.count == 1
        row = pinned.A @ at + pinned.Q @ pinned.products.values(at)
        expected = instance.A @ at + instance.Q @ instance.products.values(at)
        np.testing.assert_allclose(row, expected)


def test_integers_outside_their_bounds_are_infeasible_not_moved() -> None:
    instance = bilinear(0)
    upper = np.where(instance.integer, 0.0, instance.upper)
    held = replace(instance, upper=upper)
    pinned = FixedIntegerForm.of(held).at(np.ones(instance.size))
    assert (pinned.lower > pinned.upper).any()


def test_mistakes() -> None:
    instance = disjunctive(0)
    with pytest.raises(UsageError, match="2 alternatives to pin"):
        FixedIntegerForm.of(instance).at(np.zeros(instance.size))
    with pytest.raises(UsageError, match="not a number"):
        FixedIntegerForm.of(instance).at(np.full(instance.size, np.nan), np.array([0, 0]))
    assert not FixedIntegers(np.zeros(2), np.zeros(0, np.int64)).accepts(instance)
