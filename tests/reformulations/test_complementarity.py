"""Complementarity constraints: answers pass the exact check, agree, update numbers only."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from cart_pole import cart_pole, random_theta
from scip_oracle import scip_optimum
from small_programs import TOLERANCE, enumerated, random_numbers, small_program

from climbplan.errors import UsageError
from climbplan.program import Program
from climbplan.reformulations.complementarity import Complementarity
from climbplan.reformulations.nlp_form import Gap, NlpOptions, build_nlp_form
from climbplan.solvers.ipopt.instances import compute_box_center, solve_fixed_integers
from climbplan.solvers.ipopt.mpcc import HOMOTOPY, STRAIGHT, follow_homotopy, solve_mpcc

KINDS: tuple[Gap, ...] = ("product", "fischer-burmeister")
SCENES = 8


@pytest.mark.slow
@pytest.mark.parametrize("bilinear", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_answers_pass_the_check_and_come_near_the_enumerated_optimum(
    kind: Gap, bilinear: bool
) -> None:
    p = small_program(bilinear)
    rng = np.random.default_rng(3)
    found = near = 0
    for _ in range(SCENES):
        theta = random_numbers(rng)
        instance = p.instantiate(theta)
        result = solve_mpcc(instance, method=Complementarity(kind))
        if result.x is None:
            continue
        found += 1
        assert p.check(result.x, theta, result.assignment).passed(TOLERANCE)
        best = enumerated(instance)
        if not bilinear:
            assert result.objective >= best - 1e-5
        near += result.objective <= 1.1 * best + 1e-2
    assert found >= SCENES - 1
    assert near >= SCENES // 2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("coupling", ["product", "big-m"])
def test_homotopy_reaches_eps(kind: Gap, coupling: str) -> None:
    instance = small_program(False).instantiate(random_numbers(np.random.default_rng(5)))
    method = Complementarity(kind, coupling)  # type: ignore[arg-type]
    relaxed = follow_homotopy(instance, method, compute_box_center(instance), blur=1.0)
    assert [step.eps for step in relaxed.steps] == list(HOMOTOPY)
    assert relaxed.rounded.fraction <= 1.1 * HOMOTOPY[-1]
    assert np.all(np.isin(relaxed.rounded.x[instance.integer], [0.0, 1.0]))


def test_both_kinds_agree_where_the_start_has_the_right_integers() -> None:
    p = small_program(True)
    rng = np.random.default_rng(7)
    for _ in range(4):
        instance = p.instantiate(random_numbers(rng))
        first = solve_mpcc(instance)
        assert first.x is not None
        again = [
            solve_mpcc(
                instance,
                start=first.x,
                assignment=first.assignment,
                homotopy=STRAIGHT,
                method=Complementarity(kind),
            )
            for kind in KINDS
        ]
        for result in again:
            assert result.objective == pytest.approx(first.objective, abs=1e-5)


def test_product_coupling_leaks_less_than_big_m_and_the_polish_nothing() -> None:
    instance = cart_pole().instantiate(random_theta(np.random.default_rng(2)))
    good = scip_optimum(instance)
    assert good is not None
    leak = {}
    for coupling in ("product", "big-m"):
        method = Complementarity("product", coupling)  # type: ignore[arg-type]
        point = follow_homotopy(instance, method, good, homotopy=STRAIGHT)
        leak[coupling] = point.violation
        polished = solve_fixed_integers(instance, point.rounded.x)
        assert instance.violation(polished.v) <= 1e-6
    assert leak["product"] < 1e-4 < leak["big-m"]


def test_another_theta_updates_numbers_only() -> None:
    p, fresh = small_program(True), small_program(True)
    rng = np.random.default_rng(11)
    first, second = random_numbers(rng), random_numbers(rng)
    manner = NlpOptions("product")
    assert build_nlp_form(p.instantiate(first), manner) is build_nlp_form(
        p.instantiate(second), manner
    )
    solve_mpcc(p.instantiate(first))
    updated, rebuilt = solve_mpcc(p.instantiate(second)), solve_mpcc(fresh.instantiate(second))
    assert updated.x is not None
    np.testing.assert_array_equal(updated.x, rebuilt.x)


def test_form_reproduces_the_instance() -> None:
    p = small_program(True)
    instance = p.instantiate(random_numbers(np.random.default_rng(0)))
    form = build_nlp_form(instance, NlpOptions("pinned"))
    values = ca.Function("values", [form.v, form.p], [form.f, form.g])
    rng = np.random.default_rng(1)
    feasible = 0
    for k in range(200):
        x = np.concatenate([rng.uniform(-1, 1, 3), np.eye(3)[k % 3]])
        chosen = instance.assignment(x)
        f, g = (np.array(out).ravel() for out in values(x, form.build_parameters(instance)))
        assert f[0] == pytest.approx(instance.objective(x))
        bounds = form.compute_fixed_bounds(instance, x, chosen)
        inside = (g >= bounds.row_lower - 1e-9).all() and (g <= bounds.row_upper + 1e-9).all()
        assert inside == (instance.violation(x, chosen) <= 1e-9)
        feasible += bool(inside)
    assert 0 < feasible < 200


def test_big_m_refuses_what_is_not_bounded() -> None:
    p = Program("open")
    x, z = p.continuous("x", (1,)), p.binary("z", (1,))
    p.when("above", z, x, lower=1.0)
    p.minimise("cost", x[0] ** 2 + (1 - z[0]))
    instance = p.instantiate()
    assert not Complementarity(coupling="big-m").accepts(instance)
    assert Complementarity(coupling="product").accepts(instance)
    with pytest.raises(UsageError, match="lack"):
        solve_mpcc(instance, method=Complementarity(coupling="big-m"))
    assert solve_mpcc(instance).objective == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("damping", [0.0, pytest.param(0.1, marks=pytest.mark.slow)])
def test_cart_pole_from_a_neighbour(damping: float) -> None:
    p = cart_pole(damping)
    rng = np.random.default_rng(4)
    solved = 0
    for _ in range(5):
        theta = random_theta(rng)
        neighbour = scip_optimum(p.instantiate(theta))
        assert neighbour is not None
        moved = {**theta, "start": theta["start"] + rng.normal(0, 2e-3, 4)}
        result = solve_mpcc(p.instantiate(moved), start=neighbour, homotopy=STRAIGHT)
        assert result.x is None or p.check(result.x, moved).passed(TOLERANCE)
        solved += result.x is not None
    assert solved >= 3
