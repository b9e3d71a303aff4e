"""Scaled coordinates: same cost, same rows, equations gone; boxes that hold."""

from __future__ import annotations

import numpy as np
import pytest
from random_scenes import stepping_scene, tiny_instance

from climbplan.program import Instance, Program
from climbplan.program.box import propagate_box
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound
from climbplan.solvers.tree.choice_hulls import build_choice_hulls, compute_max_cost
from climbplan.solvers.tree.choice_table import ChoiceTable
from climbplan.solvers.tree.normal_form import NormalForm, build_normal_form
from climbplan.solvers.tree.relaxation import RelaxationSolver


def cost(form: NormalForm, z: np.ndarray) -> float:
    curved = np.delete(z, form.cost.flat)
    return float(0.5 * curved @ curved + form.cost.slope @ z) + form.cost.constant


@pytest.mark.parametrize("seed", range(40))
def test_cost_rows_and_balls_are_those_of_the_instance(seed: int) -> None:
    instance = tiny_instance(seed)
    form = build_normal_form(instance)
    if not form.cost.consistent:
        return
    rng = np.random.default_rng(seed)
    for _ in range(5):
        z = rng.normal(size=form.size)
        x = form.recover_x(z)
        assert cost(form, z) == pytest.approx(instance.objective(x), rel=1e-6, abs=1e-6)
        excess = np.linalg.norm(form.balls.vectors(z), axis=1) - form.balls.radii(z)
        known = np.concatenate([np.zeros(0), *(b.excess(x) for b in instance.balls)])
        np.testing.assert_allclose(excess, known, atol=1e-8)
        for c, choice in enumerate(instance.choices):
            here = slice(form.start[c], form.start[c + 1])
            along = form.rows[here] @ z + form.offset[here]
            y = form.tables[c].directions @ choice.point(x)
            np.testing.assert_allclose(along, y, atol=1e-8)


@pytest.mark.parametrize("seed", range(8))
def test_equations_hold_everywhere(seed: int) -> None:
    instance = stepping_scene(seed).instantiate()
    form = build_normal_form(instance)
    x = form.recover_x(np.random.default_rng(seed).normal(size=form.size))
    for choice in instance.choices:
        planes = [np.abs(p.C @ choice.point(x) - p.c).max() for p in choice.alternatives]
        assert max(planes) <= 1e-9
    assert form.size == instance.size - len(instance.choices)  # one coordinate a toe


def test_limbs_and_body_are_parts_that_only_balls_couple() -> None:
    instance = stepping_scene(0, rounds=3, limbs=2, blocked=True).instantiate()
    form = build_normal_form(instance)
    with_choices = {group.component for group in form.groups}
    assert len(with_choices) == 3
    for label, group in zip(("reach", "toe_step"), (2, 0), strict=True):
        count = instance.balls[group].count
        first = sum(b.count for b in instance.balls[:group])
        parts = form.balls.component[first : first + count]
        assert (parts < 0).all() == (label == "reach")


@pytest.mark.parametrize("seed", range(40))
def test_box_contains_the_optimum_and_ceiling_its_cost(seed: int) -> None:
    instance = tiny_instance(seed)
    result = solve_branch_and_bound(instance)
    if result.x is None:
        return
    assert result.objective is not None
    box = propagate_box(
        instance,
        build_choice_hulls(instance, [ChoiceTable.build(c.alternatives) for c in instance.choices]),
    )
    assert (box.lower <= result.x + 1e-7).all()
    assert (box.upper >= result.x - 1e-7).all()
    assert compute_max_cost(instance, box) >= result.objective


def test_box_follows_steps_from_the_start() -> None:
    instance = stepping_scene(0, rounds=3, step=0.3).instantiate()
    box = propagate_box(
        instance,
        build_choice_hulls(instance, [ChoiceTable.build(c.alternatives) for c in instance.choices]),
    )
    body = slice(18, 27)  # three rounds of the body, after 3 x 2 toes
    steps = np.repeat([0.3, 0.6, 0.9], 3)
    assert (box.half[body] <= steps + 1e-6).all()
    np.testing.assert_allclose(box.half[body][[1, 4, 7]], steps[[1, 4, 7]])  # forward: free


def test_weak_entries_of_a_row_do_not_bound() -> None:
    p = Program("weak")
    x = p.continuous("x", (2,), -1.0, 1.0)
    p.between("row", np.array([[1.0, 1e-13]]) @ x, 0.5, 0.5 + 1e-12)
    p.minimise("size", np.sum(x**2))
    box = propagate_box(p.instantiate(), build_choice_hulls(p.instantiate(), []))
    assert box.lower[1] == -1.0
    assert box.upper[1] == 1.0
    assert box.half[0] <= 1e-6


def flat_instance() -> Instance:
    p = Program("flat")
    x, y = p.continuous("x", (2,), -1.0, 1.0), p.continuous("y", (1,), -2.0, 4.0)
    p.minimise("cost", (x[0] - x[1]) ** 2 + 0.5 * y[0])
    return p.instantiate()


def test_flat_coordinates_span_the_box() -> None:
    form = build_normal_form(flat_instance())
    assert len(form.cost.flat) == 2
    corners = np.array([[1.0, 1.0, 4.0], [-1.0, -1.0, -2.0]])
    for corner in corners:
        z = np.linalg.lstsq(form.cost.X, corner - form.cost.center, rcond=None)[0]
        np.testing.assert_allclose(form.recover_x(z), corner, atol=1e-9)
        assert (np.abs(z[form.cost.flat]) <= form.cost.extent[form.cost.flat] + 1e-9).all()


def test_dual_values_are_below_the_optimum_for_any_multipliers() -> None:
    for seed in range(30):
        instance = tiny_instance(seed)
        result = solve_branch_and_bound(instance)
        form = build_normal_form(instance)
        if result.objective is None or not form.size or form.contradiction:
            continue
        relaxation = RelaxationSolver(form)
        rng = np.random.default_rng(seed)
        lower, upper = relaxation.compute_bounds(form.root_masks)
        for _ in range(20):
            rows = np.flatnonzero(rng.random(len(lower)) < 0.4)
            multiplier = np.abs(rng.normal(size=len(rows)))
            at_lower = (upper[rows] >= 1e30) | (rng.random(len(rows)) < 0.5)
            multiplier[at_lower] *= -1.0
            open_side = (at_lower & (lower[rows] <= -1e30)) | (~at_lower & (upper[rows] >= 1e30))
            rows, multiplier = rows[~open_side], multiplier[~open_side]
            value = relaxation.compute_dual_value(rows, multiplier, lower, upper)
            assert value <= result.objective + 1e-7
