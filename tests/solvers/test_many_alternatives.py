"""Choices among very many alternatives: few hull directions, sectors, exact rows where chosen."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest
from random_scenes import frame_of, polygon, random_polygon, stepping_scene

from climbplan.program import Instance, Polytope, Program
from climbplan.solvers.tree import choice_table
from climbplan.solvers.tree import search as tree_search
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound
from climbplan.solvers.tree.branching import compute_violations
from climbplan.solvers.tree.choice_table import ChoiceTable
from climbplan.solvers.tree.normal_form import build_normal_form
from climbplan.solvers.tree.row_pool import RowPool
from climbplan.solvers.tree.sectors import split_by_sectors


def as_if_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Treat small choices as if they had hundreds of alternatives."""
    monkeypatch.setattr(choice_table, "_MAX_TABLE_SIZE", 0)
    monkeypatch.setattr(choice_table, "_MAX_LISTED", 0)
    monkeypatch.setattr(choice_table, "_NUM_DIRECTIONS", 3)


def stones(seed: int, count: int) -> tuple[Polytope, ...]:
    """Small polygons scattered over one wall."""
    rng = np.random.default_rng(seed)
    frame = frame_of(0.2, 0.7)
    return tuple(
        polygon(
            f"stone {k}",
            random_polygon(rng, rng.uniform(-2.0, 2.0, 2), rng.uniform(0.02, 0.08)),
            frame,
            np.zeros(3),
        )
        for k in range(count)
    )


def walking(count: int, rounds: int = 6, limbs: int = 4, reach: float = 0.3) -> Instance:
    """Limbs step over one wall of stones, each within reach of a body."""
    alternatives = stones(0, count)
    frame = frame_of(0.2, 0.7)
    p = Program("stones")
    toe = p.continuous("toe", (rounds, limbs, 3), -3.0, 3.0)
    body = p.continuous("body", (rounds, 3), -3.0, 3.0)
    corners = np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(limbs) / limbs])
    stance = 0.4 * corners @ frame[:, :2].T
    way = np.linspace(-1.2, 1.2, rounds + 1)[:, None] * frame[:, 0]
    p.ball("reach", toe - body[:, None] - stance, reach)
    p.ball("step", np.diff(body, axis=0), 0.6)
    p.one_of("stone", toe, [alternatives] * (rounds * limbs))
    p.minimise("way", np.sum((body - way[1:]) ** 2) + 0.1 * np.sum((body[0] - way[0]) ** 2))
    p.minimise("toes", 0.5 * np.sum((toe - body[:, None] - stance) ** 2))
    return p.instantiate()


@pytest.mark.parametrize("seed", range(16))
def test_the_same_optimum_as_among_few(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    instance = stepping_scene(
        seed, rounds=3, limbs=2, patches=4, step=0.5, reach=0.75, blocked=seed % 3 == 0
    ).instantiate()
    few = solve_branch_and_bound(instance, gap=1e-6)
    as_if_many(monkeypatch)
    assert not build_normal_form(instance).tables[0].is_complete
    many = solve_branch_and_bound(instance, gap=1e-6)
    assert many.status == few.status
    assert many.objective == pytest.approx(few.objective, rel=3e-6)


def test_points_are_held_against_all_that_an_alternative_states(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    as_if_many(monkeypatch)
    instance = stepping_scene(4, rounds=2, limbs=2, patches=4).instantiate()
    form = build_normal_form(instance)
    rng = np.random.default_rng(0)
    z = rng.normal(size=form.size)
    off = compute_violations(form, z, form.rows[form.choice_rows] @ z, form.allowed)
    for c, choice in enumerate(instance.choices):
        known = choice.violations(form.recover_x(z))
        np.testing.assert_allclose(off[c, : len(known)], known, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_sectors_divide_the_set_and_leave_the_point_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = ChoiceTable.build(stones(seed, 100))
    assert not table.has_listed_divisions
    members = rng.choice(100, int(rng.integers(2, 90)), replace=False)
    mask = sum(1 << int(r) for r in members)
    y = table.directions @ (frame_of(0.2, 0.7)[:, :2] @ rng.uniform(-1.5, 1.5, 2))
    splits = split_by_sectors(table, mask, y)
    ends = [*splits.first[1:], len(splits.children)]
    for start, end in zip(splits.first, ends, strict=True):
        children = splits.children[start:end]
        assert len(children) >= 2
        assert all(children)
        assert sum(children) == mask  # without overlap, or bits would be carried
        assert np.bitwise_or.reduce([c % (1 << 62) for c in children]) == mask % (1 << 62)
    for child, low, high in zip(splits.children, splits.lower, splits.upper, strict=True):
        np.testing.assert_array_equal(low, table.compute_hull(child)[0])
        np.testing.assert_array_equal(high, table.compute_hull(child)[1])
    off = np.maximum(splits.lower - y, y - splits.upper).max(axis=1)
    assert (off > 0).sum() >= min(3, len(off) - 1)


def test_alternatives_that_all_enclose_the_point_are_halved() -> None:
    rng = np.random.default_rng(1)
    frame = frame_of(0.2, 0.7)
    ring = tuple(
        polygon(f"{k}", random_polygon(rng, np.zeros(2), 1.0 + 0.01 * k), frame, np.zeros(3))
        for k in range(80)
    )
    table = ChoiceTable.build(ring)
    splits = split_by_sectors(table, table.all_alternatives, np.zeros(len(table.directions)))
    assert len(splits.children) == 2
    assert [c.bit_count() for c in splits.children] == [40, 40]


def test_hundreds_of_stones_are_planned_in_little_memory() -> None:
    """24 choices among 300 polygons with some 1200 directions: all ways to divide took 10 GB."""
    instance = walking(300)
    tracemalloc.start()
    begin = time.process_time()
    found = solve_branch_and_bound(instance, gap=1e-2, time_limit=60.0)
    spent, (_, peak) = time.process_time() - begin, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.status in ("optimal", "feasible")
    assert peak < 300e6
    assert spent < 66.0


@pytest.mark.parametrize("limit", [0.0, 0.3, 1.5])
def test_a_time_limit_is_kept_from_the_first_step_on(limit: float) -> None:
    instance = walking(200, rounds=10, reach=0.06)
    begin = time.perf_counter()
    found = solve_branch_and_bound(instance, gap=0.0, time_limit=limit)
    assert time.perf_counter() - begin < 1.1 * limit + 1.0
    assert found.status in ("feasible", "limit", "optimal")
    assert found.x is not None or found.status == "limit"


def test_open_nodes_are_bounded_by_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    instance = walking(60, rounds=4, reach=0.1)
    pool = RowPool(build_normal_form(instance))
    monkeypatch.setattr(tree_search, "MEMORY", pool.num_bytes + 20e3)
    found = solve_branch_and_bound(instance, gap=0.0, time_limit=60.0)
    assert found.status in ("feasible", "limit")
    assert any("fill" in line for line in found.log)
    assert np.isfinite(found.bound)
