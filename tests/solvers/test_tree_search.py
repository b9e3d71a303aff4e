"""What a node of the tree passes on: exclusions and children's bounds against exact optima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_scenes import stepping_scene

from climbplan.arrays import BoolArray
from climbplan.program import Instance
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound
from climbplan.solvers.tree.incumbent import FeasiblePoint
from climbplan.solvers.tree.normal_form import build_normal_form
from climbplan.solvers.tree.search import ChoiceNode, TreeSearch


def scene(seed: int) -> Instance:
    return stepping_scene(
        seed,
        rounds=3,
        limbs=2,
        patches=3,
        step=0.45,
        reach=0.7 + 0.03 * (seed % 4),
        blocked=seed % 2 == 0,
    ).instantiate()


def best_with(instance: Instance, choice: int, allowed: BoolArray) -> float:
    """The optimum if one choice has only some of its alternatives, infinite if there is none."""
    choices = list(instance.choices)
    kept = tuple(p for p, use in zip(choices[choice].alternatives, allowed, strict=False) if use)
    choices[choice] = replace(choices[choice], alternatives=kept)
    result = solve_branch_and_bound(replace(instance, choices=tuple(choices)), gap=1e-6)
    return np.inf if result.objective is None else result.objective


def searching(instance: Instance) -> tuple[TreeSearch, ChoiceNode]:
    """A search and its root after some cut rounds."""
    form = build_normal_form(instance)
    search = TreeSearch(instance, form, 1e-6, np.inf, 1e-7)
    root = search.create_root()
    point = search._relax_with_cuts(root, 10, 1e-6, stop_early=False)
    assert point is not None
    return search, replace(root, start=point, bound=point.bound)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_excluded_alternatives_hold_no_better_plan(seed: int) -> None:
    instance = scene(seed)
    found = solve_branch_and_bound(instance, gap=1e-6)
    assert found.x is not None
    assert found.assignment is not None
    assert found.objective is not None
    search, root = searching(instance)
    # A worse incumbent excludes less, but its exclusions show errors of the bounds more clearly.
    for share in (1.0, 1.05, 1.5):
        objective = found.objective * share
        search.incumbents.best = FeasiblePoint(found.x, found.assignment, objective)
        cutoff = search.incumbents.cutoff
        bounds = search.relaxation.compute_bounds(root.masks)
        _, gains = search._compute_component_gains(root, root.start, *bounds, is_root=True)
        rates = search._compute_rates(root.start, *bounds)
        value = search._compute_choice_values(root.start)
        before = search.form.allowed
        allowed = search._exclude_alternatives(root, before, root.start, value, rates, gains)
        for choice, alternative in zip(*np.nonzero(before & ~allowed), strict=True):
            only = np.arange(allowed.shape[1]) == alternative
            assert best_with(instance, int(choice), only) >= cutoff * (1 - 1e-6)


def test_something_is_excluded() -> None:
    count = 0
    for seed in range(12):
        instance = scene(seed)
        found = solve_branch_and_bound(instance, gap=1e-6)
        assert found.x is not None
        assert found.assignment is not None
        assert found.objective is not None
        search, root = searching(instance)
        search.incumbents.best = FeasiblePoint(found.x, found.assignment, found.objective)
        bounds = search.relaxation.compute_bounds(root.masks)
        _, gains = search._compute_component_gains(root, root.start, *bounds, is_root=True)
        rates = search._compute_rates(root.start, *bounds)
        value = search._compute_choice_values(root.start)
        before = search.form.allowed
        allowed = search._exclude_alternatives(root, before, root.start, value, rates, gains)
        count += int((before & ~allowed).sum())
    assert count >= 12


@pytest.mark.parametrize("seed", range(16))
def test_bounds_of_children_hold_in_them(seed: int) -> None:
    instance = scene(seed)
    search, root = searching(instance)
    search._process(root)
    if search.incumbents.best is not None and not search._open:
        return
    assert search._open
    for bound, _, child in search._open:
        allowed = search.form.decode_masks(child.masks)
        narrowed = (allowed != search.form.allowed).any(axis=1)
        choice = int(np.flatnonzero(narrowed)[0])
        least = best_with(instance, choice, allowed[choice])
        assert bound <= least * (1 + 1e-6) + 1e-9


@pytest.mark.parametrize("seed", range(40))
def test_what_is_left_and_closed_bounds_the_optimum(seed: int) -> None:
    """After any number of nodes, with an incumbent that is far from optimal."""
    instance = scene(seed)
    found = solve_branch_and_bound(instance, gap=1e-6)
    assert found.x is not None
    assert found.assignment is not None
    assert found.objective is not None
    search, root = searching(instance)
    search.gap = search.incumbents.gap = 0.1 + 0.1 * (seed % 3)
    far = FeasiblePoint(found.x, found.assignment, found.objective * (1.05 + 0.1 * (seed % 5)))
    search._open.append((root.bound, 0, root))
    for _ in range(40):
        search.incumbents.best = far  # forget better ones: nodes are closed at its cutoff
        if not search._open and not search._dive:
            break
        node = search._dive.pop() if search._dive else search._open.pop(0)[2]
        if node.bound >= search.incumbents.cutoff:
            search.closed_bound = min(search.closed_bound, node.bound)
            continue
        search._process(node)
        search.incumbents.best = far
        assert search.bound <= found.objective * (1 + 1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_a_relaxation_at_the_cutoff_closes_its_node_with_a_bound(seed: int) -> None:
    instance = scene(seed)
    found = solve_branch_and_bound(instance, gap=1e-6)
    assert found.x is not None
    assert found.assignment is not None
    search, root = searching(instance)
    start = replace(root, start=search.relaxation.start())
    search.incumbents.best = FeasiblePoint(found.x, found.assignment, root.bound * 0.9)
    assert np.isinf(search.closed_bound)
    assert search._relax_with_cuts(start, 10, 1e-6, stop_early=False) is None
    assert search.incumbents.cutoff <= search.closed_bound <= found.objective * (1 + 1e-9)
    assert not search.proves_infeasible
