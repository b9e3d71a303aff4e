"""D and U in closed form against horizontal slices, and their bounds over angle boxes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bookshelf_oracle import apart, farthest, outline
from hypothesis import given, settings
from hypothesis import strategies as st

from climbplan.bookshelf.exact.contact import bound_contact_distance, compute_contact_distance
from climbplan.bookshelf.exact.pairs import (
    bound_pair_separation,
    fill_angle_box,
    maximise_sinusoid,
    minimise_sinusoid,
)

GAP = 4.1
RIGHT_ANGLE = math.pi / 2

lengths = st.floats(1.0, 100.0)
sides = st.sampled_from([-1.0, 1.0])
shares = st.floats(0.0, 1.0)
tilts = st.one_of(st.just(0.0), st.just(RIGHT_ANGLE), st.floats(0.0, RIGHT_ANGLE))


def _box(low: float, high: float) -> np.ndarray:
    row = np.zeros(7)
    fill_angle_box(low, high, row)
    return row


def _interval(a: float, width: float) -> tuple[float, float]:
    return a, min(a + width, RIGHT_ANGLE)


books = st.tuples(sides, lengths, lengths)
intervals = st.builds(_interval, tilts, st.sampled_from([0.0, 1e-4, 0.01, 0.1, 0.5, 2.0]))


@settings(max_examples=300, deadline=None)
@given(books, tilts, books, tilts)
def test_least_distance_is_the_widest_slice(
    i: tuple[float, float, float], a: float, j: tuple[float, float, float], b: float
) -> None:
    (side_i, w_i, h_i), (side_j, w_j, h_j) = i, j
    constant, plane, g, h = bound_pair_separation(*i, _box(a, a), *j, _box(b, b), 0.0)
    expected = apart(outline(side_i * a, h_i, w_i), outline(side_j * b, h_j, w_j))
    assert constant == pytest.approx(expected, abs=1e-6)
    assert (plane, g, h) == (constant, 0.0, 0.0)


@settings(max_examples=150, deadline=None)
@given(books, tilts, books, tilts)
def test_farthest_contact_is_found_by_bisection(
    i: tuple[float, float, float], a: float, j: tuple[float, float, float], b: float
) -> None:
    (side_i, w_i, h_i), (side_j, w_j, h_j) = i, j
    end, _, _, _ = compute_contact_distance(*i, _box(a, a), *j, _box(b, b), GAP)
    expected = farthest(outline(side_i * a, h_i, w_i), outline(side_j * b, h_j, w_j), GAP)
    assert end == pytest.approx(expected, abs=1e-6)


@settings(max_examples=400, deadline=None)
@given(
    books,
    intervals,
    books,
    intervals,
    st.sampled_from([-1.0, 0.0, 1.0]),
    st.lists(st.tuples(shares, shares), min_size=1, max_size=8),
)
def test_bounds_hold_everywhere_in_the_boxes(
    i: tuple[float, float, float],
    a: tuple[float, float],
    j: tuple[float, float, float],
    b: tuple[float, float],
    aim: float,
    points: list[tuple[float, float]],
) -> None:
    box_i, box_j = _box(*a), _box(*b)
    constant, floor, g, h = bound_pair_separation(*i, box_i, *j, box_j, aim)
    ceiling, u, v = bound_contact_distance(*i, box_i, *j, box_j, GAP)
    for s, t in [*points, (0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]:
        at_i, at_j = a[0] + s * (a[1] - a[0]), b[0] + t * (b[1] - b[0])
        d_i, d_j = at_i - (a[0] + a[1]) / 2, at_j - (b[0] + b[1]) / 2
        point_i, point_j = _box(at_i, at_i), _box(at_j, at_j)
        least = bound_pair_separation(*i, point_i, *j, point_j, 0.0)[0]
        slack = 1e-9 * (1 + abs(least))
        assert constant <= least + slack
        assert floor + g * d_i + h * d_j <= least + slack
        farthest_here = compute_contact_distance(*i, point_i, *j, point_j, GAP)[0]
        plane = ceiling + u * d_i + v * d_j
        assert plane >= farthest_here - 1e-9 * (1 + abs(plane))


def test_planes_are_tight_to_second_order() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        i = (rng.choice([-1.0, 1.0]), rng.uniform(10, 40), rng.uniform(50, 90))
        j = (rng.choice([-1.0, 1.0]), rng.uniform(10, 40), rng.uniform(50, 90))
        a, b = rng.uniform(0.3, 1.2, 2)
        exact = bound_pair_separation(*i, _box(a, a), *j, _box(b, b), 0.0)[0]
        errors = []
        for r in (0.01, 0.001):
            plane = bound_pair_separation(*i, _box(a - r, a + r), *j, _box(b - r, b + r), 0.0)[1]
            errors.append(exact - plane)
        assert errors[1] <= errors[0] / 9 + 1e-9  # a switch of axes costs first order, not here
        assert errors[0] < 1.0


def test_planes_on_both_sides_of_a_crease() -> None:
    # Equal books leaning face to face: D rises to both sides of equal tilts, so that the plane of
    # one corner is far below it on one of them.
    book = (1.0, 20.0, 70.0)
    a, r = 0.7, 0.01
    box = _box(a - r, a + r)
    for side in (1.0, -1.0):
        high, low = _box(a + side * r, a + side * r), _box(a - side * r, a - side * r)
        exact = bound_pair_separation(*book, high, *book, low, 0.0)[0]
        gaps = []
        for aim in (-side, 0.0, side):
            _, p, g, h = bound_pair_separation(*book, box, *book, box, aim)
            gaps.append(exact - (p + g * side * r - h * side * r))
        assert min(gaps) == gaps[2]
        assert gaps[2] < 0.02
        assert gaps[0] > 0.5


@pytest.mark.parametrize(
    ("tilt", "gap", "feature"), [(1.5448, 0.5, 2), (1.55, 0.5, 2), (1.5408, 4.1, 4), (1.2, 0.7, 2)]
)
def test_contact_with_a_nearly_flat_book_is_bounded_ever_closer(
    tilt: float, gap: float, feature: int
) -> None:
    # It leans to the left over a flat book: the face that touches is too steep for planes.
    flat, leaning = (1.0, 1.143, 33.0), (1.0, 2.159, 125.6)
    under = _box(RIGHT_ANGLE, RIGHT_ANGLE)
    exact, found, _, _ = compute_contact_distance(*flat, under, *leaning, _box(tilt, tilt), gap)
    assert found == feature
    errors = []
    for r in (1e-3, 1e-4, 1e-5, 1e-6):
        ceiling, _, h = bound_contact_distance(
            *flat, under, *leaning, _box(tilt - r, tilt + r), gap
        )
        errors.append(ceiling + abs(h) * r - exact)
    assert min(errors) >= -1e-9
    assert errors[3] < 0.02 * errors[1] + 1e-6


def test_ranges_of_harmonics() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        p, q = rng.normal(size=2)
        low, high = np.sort(rng.uniform(0, RIGHT_ANGLE, 2))
        t = np.linspace(low, high, 2001)
        values = p * np.sin(t) + q * np.cos(t)
        box = _box(low, high)
        assert maximise_sinusoid(p, q, box) == pytest.approx(values.max(), abs=1e-6)
        assert minimise_sinusoid(p, q, box) == pytest.approx(values.min(), abs=1e-6)
