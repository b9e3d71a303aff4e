"""What the search builds its bounds from: gains, minima of parts, cuts, certificates."""

from __future__ import annotations

import numpy as np
import pytest
from random_scenes import stepping_scene, tiny_instance

from climbplan.solvers.tree.block_minima import build_component_problems
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound
from climbplan.solvers.tree.branching import (
    compute_alternative_gains,
    compute_violations,
    select_split,
)
from climbplan.solvers.tree.certificate import compute_farkas_bound
from climbplan.solvers.tree.choice_table import UNBOUNDED
from climbplan.solvers.tree.dual_gains import compute_dual_steps
from climbplan.solvers.tree.normal_form import build_normal_form
from climbplan.solvers.tree.relaxation import ClosedRelaxation, RelaxationPoint, RelaxationSolver


def relaxed(relaxation: RelaxationSolver) -> RelaxationPoint | None:
    """The root relaxation with a few rounds of ball cuts."""
    form, point = relaxation.form, relaxation.start()
    for _ in range(6):
        bounds = relaxation.compute_bounds(form.root_masks)
        solved = relaxation.solve(*bounds, point)
        if isinstance(solved, ClosedRelaxation):
            return None
        point = solved
        if relaxation.cut_balls(point.z, 1e-7).count == 0:
            break
    bounds = relaxation.compute_bounds(form.root_masks)
    solved = relaxation.solve(*bounds, point)
    return None if isinstance(solved, ClosedRelaxation) else solved


def instances() -> list[object]:
    tiny = [pytest.param(tiny_instance(seed), id=f"tiny {seed}") for seed in range(25)]
    steps = [
        pytest.param(stepping_scene(seed, blocked=seed % 2 == 0).instantiate(), id=f"steps {seed}")
        for seed in range(6)
    ]
    return [*tiny, *steps]


@pytest.mark.parametrize("instance", instances())
def test_gains_never_promise_more_than_a_child_relaxation_reaches(instance: object) -> None:
    form = build_normal_form(instance)
    if form.contradiction or not form.size:
        return
    relaxation = RelaxationSolver(form)
    point = relaxed(relaxation)
    if point is None:
        return
    lower, upper = relaxation.compute_bounds(form.root_masks)
    rows, active = form.rows[form.choice_rows], point.active
    fixed = upper[active] - lower[active] <= 0.0
    rates = compute_dual_steps(
        rows, relaxation.pool.M[active], point.multiplier, fixed, point.z, form.cost
    )
    value = rows @ point.z
    gains = compute_alternative_gains(form, value, rates, np.ones(len(form.tables), bool))
    for c, r in zip(*np.nonzero(form.allowed), strict=True):
        allowed = form.allowed.copy()
        allowed[c] = np.arange(allowed.shape[1]) == r
        child = relaxation.solve(*relaxation.compute_bounds(form.encode_masks(allowed)), point)
        assert gains[c, r] >= 0.0
        assert point.bound + gains[c, r] <= child.bound + 1e-7 * max(1.0, abs(child.bound))


@pytest.mark.parametrize("seed", range(10))
def test_some_gains_are_worth_having(seed: int) -> None:
    """On chains of steps the projected gain is more than half of what the child reaches."""
    form = build_normal_form(stepping_scene(seed, rounds=3, limbs=2).instantiate())
    relaxation = RelaxationSolver(form)
    point = relaxed(relaxation)
    assert point is not None
    lower, upper = relaxation.compute_bounds(form.root_masks)
    active = point.active
    rows = form.rows[form.choice_rows]
    fixed = upper[active] - lower[active] <= 0.0
    rates = compute_dual_steps(
        rows, relaxation.pool.M[active], point.multiplier, fixed, point.z, form.cost
    )
    gains = compute_alternative_gains(form, rows @ point.z, rates, np.ones(len(form.tables), bool))
    assert gains.max() > 0.0
    off = compute_violations(form, point.z, rows @ point.z, form.allowed)
    split = select_split(
        form, rows @ point.z, rates, form.root_masks, np.flatnonzero(off.min(1) > 1e-7)
    )
    assert len(split.children) >= 2
    assert sum(split.children) == form.tables[split.choice].encode_mask(form.allowed[split.choice])


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("blocked", [False, True])
def test_minima_of_parts_add_up_to_a_bound(seed: int, blocked: bool) -> None:
    instance = stepping_scene(seed, rounds=3, limbs=2, blocked=blocked).instantiate()
    optimum = solve_branch_and_bound(instance, gap=1e-6).objective
    assert optimum is not None
    form = build_normal_form(instance)
    relaxation = RelaxationSolver(form)
    point = relaxed(relaxation)
    assert point is not None
    all_lower, all_upper = relaxation.compute_bounds(form.root_masks)
    bound = point.bound
    for block in build_component_problems(form, relaxation.pool):
        base = block.compute_relaxed_value(point, all_lower, all_upper)
        price = block.compute_price(point)
        exact = block.minimise(price, form.root_masks, 0.0, 10_000, np.inf)
        early = block.minimise(price, form.root_masks, 0.0, 1, np.inf)
        assert exact.bound >= base - 1e-9
        assert early.bound <= exact.bound + 1e-9
        hinted = block.minimise(price, form.root_masks, 0.0, 10_000, np.inf, exact.assignment)
        assert hinted.bound == pytest.approx(exact.bound, abs=1e-8)
        bound += exact.bound - base
    assert bound <= optimum * (1 + 1e-5) + 1e-9


@pytest.mark.parametrize("seed", range(10))
def test_ball_cuts_cut_no_feasible_point(seed: int) -> None:
    form = build_normal_form(stepping_scene(seed).instantiate())
    relaxation = RelaxationSolver(form)
    rng = np.random.default_rng(seed)
    base = relaxation.pool.count
    for _ in range(5):
        relaxation.cut_balls(3.0 * rng.normal(size=form.size), 0.0)
    assert relaxation.pool.count > base
    cuts, upper = relaxation.pool.M[base:], relaxation.pool.upper[base:]
    kept = 0
    for _ in range(200):
        z = rng.normal(size=form.size) * rng.uniform(0, 0.3)
        inside = np.linalg.norm(form.balls.vectors(z), axis=1) <= form.balls.radii(z)
        if inside.all():
            kept += 1
            assert (cuts @ z <= upper + 1e-9).all()
    assert kept > 0 or seed  # the first scene at least has such points


@pytest.mark.parametrize("gap", [1.0, 1e-2, 1e-4, 1e-6])
def test_infeasible_rows_are_certified_however_little_they_miss(gap: float) -> None:
    rng = np.random.default_rng(0)
    M = rng.normal(size=(8, 5))
    M[7] = M[:7].sum(axis=0)
    lower, upper = np.full(8, -UNBOUNDED), np.ones(8)
    upper[7], lower[7] = UNBOUNDED, 7.0 + gap
    bound = compute_farkas_bound(rng.normal(size=5), M, lower, upper, np.zeros(5), 1e3)
    assert bound >= 1e3


def test_feasible_rows_are_never_certified_above_their_optimum() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        M = rng.normal(size=(9, 5))
        inside = rng.normal(size=5)
        upper = M @ inside + np.abs(rng.normal(size=9)) * (rng.random(9) < 0.7)
        lower = np.full(9, -UNBOUNDED)
        linear = rng.normal(size=5)
        bound = compute_farkas_bound(linear, M, lower, upper, np.zeros(5), 1e9)
        assert bound <= 0.5 * inside @ inside + linear @ inside + 1e-9
