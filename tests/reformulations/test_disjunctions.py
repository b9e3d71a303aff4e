"""Big-M and convex hull against enumeration; what is unbounded is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bilinear_programs import bilinear, disjunctive, enumerated

from climbplan.errors import UsageError
from climbplan.program import Polytope, Program
from climbplan.program.box import propagate_box
from climbplan.reformulations.disjunctions import BigM, ConvexHull
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.highs.instances import solve_highs
from climbplan.solvers.scip.bilinear import solve_minlp_scip

SEEDS = range(6)


@pytest.mark.parametrize("seed", SEEDS)
def test_exact_forms_agree_with_enumeration_and_scip(seed: int) -> None:
    instance = disjunctive(seed)
    best = enumerated(instance)
    assert best.x is not None
    for form in (BigM(), ConvexHull()):
        changed = form.apply(instance)
        assert not changed.relaxation
        assert changed.instance.features == {"integers"}
        result = solve_highs(changed.instance, gap=1e-7)
        assert result.status == "optimal"
        assert result.x is not None
        assert result.objective == pytest.approx(best.objective, abs=1e-6)
        x = changed.invert(result.x)
        assert instance.violation(x, changed.decode_alternatives(result.x)) < 1e-6
    scip = solve_minlp_scip(instance)
    assert scip.objective == pytest.approx(best.objective, abs=1e-6)
    assert scip.bound <= best.objective + 1e-5 * max(1.0, abs(best.objective))


@pytest.mark.parametrize("seed", SEEDS)
def test_hull_bounds_at_least_as_well(seed: int) -> None:
    instance = disjunctive(seed)
    bounds = []
    for form in (BigM(), ConvexHull()):
        mixed = form.apply(instance).instance
        relaxed = replace(mixed, integer=np.zeros(mixed.size, bool))
        bounds.append(solve_highs(relaxed).objective)
    # The product of the hulls of single disjunctions; big-M rows may still cut corners of others.
    assert bounds[1] >= bounds[0] - 1e-4


def test_feasible_points_stay_feasible() -> None:
    rng = np.random.default_rng(1)
    instance = disjunctive(0)
    for form in (BigM(), ConvexHull()):
        changed = form.apply(instance).instance
        pinned = 0
        for _ in range(4000):
            x = rng.uniform(instance.lower, instance.upper)
            x[instance.integer] = rng.integers(0, 2, int(instance.integer.sum()))
            if instance.violation(x) > 0:
                continue
            pinned += 1
            lower, upper = changed.lower.copy(), changed.upper.copy()
            lower[: instance.size] = np.maximum(lower[: instance.size], x - 1e-9)
            upper[: instance.size] = np.minimum(upper[: instance.size], x + 1e-9)
            held = replace(changed, lower=lower, upper=upper)
            assert solve_highs(held).x is not None
            if pinned == 10:
                break
        assert pinned >= 3


def test_unbounded_rows_are_named() -> None:
    p = Program("open")
    x = p.continuous("x", (2,))
    z = p.binary("z", (1,))
    p.when("on", z[0], x, upper=1.0)
    for form in (BigM(), ConvexHull()):
        with pytest.raises(UsageError, match=r"open: implication row 0 \(on variable 2\)"):
            form.apply(p.instantiate())
    q = Program("open")
    y = q.continuous("y", (1, 2))
    side = Polytope.halfspaces("left", np.array([[1.0, 0.0]]), np.zeros(1))
    other = Polytope.halfspaces("right", np.array([[-1.0, 0.0]]), np.zeros(1))
    q.one_of("side", y, [[side, other]])
    for form in (BigM(), ConvexHull()):
        with pytest.raises(UsageError, match=r"side\[0\], alternative left"):
            form.apply(q.instantiate())


def test_big_m_is_tight() -> None:
    p = Program("tight")
    x = p.continuous("x", (2,), [0.0, -1.0], [3.0, 1.0])
    z = p.binary("z", (1,))
    p.when("on", z[0], x[:1] + 2 * x[1:], upper=1.0)
    p.when("always", z[0], x[:1], upper=3.0)
    p.between("less", x[:1], -np.inf, 2.0)
    mixed = BigM().apply(p.instantiate()).instance
    assert mixed.A.shape[0] == 2  # the row that holds anyway needs no switch
    np.testing.assert_allclose(mixed.A[[1]].toarray(), [[1.0, 2.0, 3.0]], atol=1e-6)
    assert mixed.row_upper[1] == pytest.approx(4.0)  # 2 + 2, x0 <= 2 by propagation


@pytest.mark.parametrize("seed", range(4))
def test_box_holds_every_feasible_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    instance = bilinear(seed)
    box = propagate_box(instance)
    found = 0
    for _ in range(6000):
        x = rng.uniform(instance.lower, instance.upper)
        x[instance.integer] = np.round(x[instance.integer])
        if instance.violation(x) > 0:
            continue
        found += 1
        w = instance.products.values(x)
        assert (box.lower <= x).all()
        assert (x <= box.upper).all()
        assert (box.products.lower <= w).all()
        assert (w <= box.products.upper).all()
        reach = box.interval(instance.A, instance.Q)
        row = instance.A @ x + instance.Q @ w
        assert (reach.lower <= row + 1e-9).all()
        assert (row <= reach.upper + 1e-9).all()
    assert found > 20


def test_implications_with_products_are_switched_either_way() -> None:
    instance = bilinear(2)
    first = McCormick().apply(BigM().apply(instance).instance)
    second = BigM().apply(McCormick().apply(instance).instance)
    hull = ConvexHull().apply(McCormick().apply(instance).instance)
    answers = [solve_highs(form.instance, gap=1e-7) for form in (first, second, hull)]
    assert answers[1].objective == pytest.approx(answers[2].objective, abs=1e-5)
    scip = solve_minlp_scip(instance)
    assert scip.objective is not None
    for answer in answers:
        assert answer.bound <= scip.objective + 1e-6
