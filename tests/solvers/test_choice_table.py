"""Intervals of alternatives: hulls contain their members, splits divide them."""

from __future__ import annotations

import numpy as np
import pytest
from random_scenes import frame_of, polygon, random_polygon

from climbplan.arrays import Array
from climbplan.program import Polytope
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable


def patches(seed: int, count: int = 4, turned: bool = True) -> tuple[Polytope, ...]:
    rng = np.random.default_rng(seed)
    frame = frame_of(rng.uniform(-0.4, 0.4), rng.uniform(0, 3)) if turned else np.eye(3)
    return tuple(
        polygon(
            f"patch {k}",
            random_polygon(rng, rng.uniform(-1, 1, 2), rng.uniform(0.1, 0.5)),
            frame,
            np.array([0.1, 0.2, 0.3]),
        )
        for k in range(count)
    )


def sample(rng: np.random.Generator, polytope: Polytope) -> Array:
    assert polytope.vertices is not None
    weights = rng.dirichlet(np.ones(len(polytope.vertices)))
    return weights @ polytope.vertices


@pytest.mark.parametrize("seed", range(8))
def test_hulls_contain_their_members_and_nothing_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    alternatives = patches(seed)
    table = ChoiceTable.build(alternatives)
    for mask in range(1, 1 << table.count):
        low, high = table.compute_hull(mask)
        for r in table.list_members(mask):
            y = table.directions @ sample(rng, alternatives[r])
            assert (y >= low - 1e-9).all()
            assert (y <= high + 1e-9).all()
        larger = table.compute_hull(mask | 1)
        if len(table.list_members(mask)) > 1:
            assert (larger[0] <= low + 1e-12).all()
            assert (larger[1] >= high - 1e-12).all()


@pytest.mark.parametrize("seed", range(8))
def test_a_single_alternative_is_its_own_rows(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    alternatives = patches(seed)
    table = ChoiceTable.build(alternatives)
    for r, polytope in enumerate(alternatives):
        low, high = table.compute_hull(1 << r)
        for _ in range(20):
            y = sample(rng, alternatives[int(rng.integers(4))]) + 0.2 * rng.normal(size=3)
            along = table.directions @ y
            off = max(0.0, float((along - high).max()), float((low - along).max()))
            assert off == pytest.approx(polytope.violation(y), abs=1e-9)


def test_shared_planes_have_no_width() -> None:
    table = ChoiceTable.build(patches(0))
    low, high = table.compute_hull((1 << table.count) - 1)
    assert (high - low <= 1e-9).sum() == 1


def test_opposite_and_repeated_rows_are_one_direction() -> None:
    box = np.vstack([np.eye(2), -np.eye(2), 2 * np.eye(2)])
    one = Polytope.halfspaces("one", box, np.array([1.0, 1.0, 0.0, 0.0, 1.0, 8.0]))
    table = ChoiceTable.build((one,))
    assert len(table.directions) == 2
    low, high = table.compute_hull(1)
    order = np.argsort(np.abs(table.directions[:, 0]))[::-1]
    sign = table.directions.sum(axis=1)[order]
    np.testing.assert_allclose(np.sort(np.stack([low, high])[:, order] * sign, axis=0)[1], [0.5, 1])


@pytest.mark.parametrize("count", [2, 3, 5])
def test_splits_divide_the_set(count: int) -> None:
    table = ChoiceTable.build(patches(3, count))
    mask = (1 << count) - 1
    splits = table.list_divisions(mask)
    ends = [*splits.first[1:], len(splits.children)]
    for start, end in zip(splits.first, ends, strict=True):
        children = splits.children[start:end]
        assert len(children) == 2
        assert children[0] | children[1] == mask
        assert children[0] & children[1] == 0
        assert all(children)
    for child, low, high in zip(splits.children, splits.lower, splits.upper, strict=True):
        np.testing.assert_array_equal(low, table.compute_hull(child)[0])
        np.testing.assert_array_equal(high, table.compute_hull(child)[1])


def test_some_split_separates_disjoint_patches_from_a_point_between() -> None:
    """Two polygons and a point in the gap: both children of some split exclude it."""
    square = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])
    frame = frame_of(0.3, 1.0)
    pair = tuple(polygon(f"{k}", square + np.array([0.0, k]), frame, np.zeros(3)) for k in range(2))
    table = ChoiceTable.build(pair)
    y = table.directions @ (frame[:, 1] * 0.5)
    splits = table.list_divisions(3)
    off = np.maximum(splits.lower - y, y - splits.upper).max(axis=1)
    assert (np.minimum.reduceat(off, splits.first) > 0.25).any()


def test_unbounded_alternatives_split_one_by_one_and_hulls_know_nothing() -> None:
    sides = tuple(Polytope.halfspaces(f"{k}", -np.eye(3)[[k]], np.array([-1.0])) for k in range(3))
    table = ChoiceTable.build(sides)
    assert not table.is_bounded
    assert table.list_divisions(7).children == (1, 2, 4)
    low, high = table.compute_hull(7)
    assert (low == -UNBOUNDED).all()
    assert (high == UNBOUNDED).all()


def test_vertices_that_do_not_fit_are_not_trusted() -> None:
    box = np.vstack([np.eye(2), -np.eye(2)])
    wrong = Polytope(
        "wrong", box, np.ones(4), np.zeros((0, 2)), np.zeros(0), np.array([[5.0, 5.0]])
    )
    assert not ChoiceTable.build((wrong,)).is_bounded


def test_empty_alternatives_are_known() -> None:
    box = np.vstack([np.eye(1), -np.eye(1)])
    none = Polytope.halfspaces("none", box, np.array([-1.0, -1.0]))
    never = Polytope.halfspaces("never", np.zeros((1, 1)), np.array([-1.0]))
    some = Polytope.halfspaces("some", box, np.array([1.0, 1.0]))
    assert ChoiceTable.build((none, some, never)).is_empty.tolist() == [True, False, True]
