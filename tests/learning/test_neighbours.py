"""Nearest neighbours: their order, ties, distinct strategies, the published centroids."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.errors import UsageError
from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.neighbours import NearestCentroids, NearestProblems

FRAME = ProgramSignature("line", np.array([False, True]), np.zeros(0, np.int64))


def _library(features: list[list[float]], bits: list[int]) -> Library:
    points = np.array([[float(i), float(b)] for i, b in enumerate(bits)])
    return Library.of(FRAME, np.array(features), points, np.zeros(len(bits)))


def test_features_are_scaled() -> None:
    # 100 mm apart in the first, 1 rad in the second: equally far in their own spread
    library = _library([[0, 0], [300, 0], [0, 1], [300, 1]], [0, 0, 1, 1])
    found = NearestProblems.of(library).candidates(np.array([140.0, 0.9]), 4)
    assert [c.row for c in found] == [2, 3, 0, 1]
    assert [c.score for c in found] == sorted(c.score for c in found)


def test_equal_distances_are_ordered_by_row() -> None:
    library = _library([[1.0], [-1.0], [1.0], [-1.0]], [0, 1, 1, 0])
    for _ in range(3):
        found = NearestProblems.of(library).candidates(np.zeros(1), 4)
        assert [c.row for c in found] == [0, 1, 2, 3]


def test_distinct_strategies_first() -> None:
    library = _library([[0.0], [0.1], [0.2], [0.3]], [0, 0, 0, 1])
    rows = {
        order: [c.row for c in NearestProblems.of(library, order).candidates(np.zeros(1), 4)]
        for order in ("points", "strategies", "mixed")
    }
    assert rows == {"points": [0, 1, 2, 3], "strategies": [0, 3], "mixed": [0, 3, 1, 2]}


def test_published_centroids_use_raw_features() -> None:
    library = _library([[0, 0], [10, 0], [4, 4], [4, 4]], [0, 0, 1, 1])
    found = NearestCentroids.of(library).candidates(np.array([5.0, 1.0]), 5)
    assert [c.number for c in found] == [0, 1]  # (5, 0) is nearer than (4, 4)
    assert found[0].score == pytest.approx(1.0)
    assert [c.row for c in found] == [0, 2]  # the nearest problem of each


@pytest.mark.parametrize("features", [np.zeros(3), np.array([np.nan, 0.0])])
def test_features_that_do_not_fit_are_refused(features: np.ndarray) -> None:
    library = _library([[0, 0], [10, 0]], [0, 1])
    for strategy in (NearestProblems.of(library), NearestCentroids.of(library)):
        with pytest.raises(UsageError, match="finite features expected"):
            strategy.candidates(features, 1)


def test_an_empty_library_is_refused() -> None:
    empty = Library.of(FRAME, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    for kind in (NearestProblems, NearestCentroids):
        with pytest.raises(UsageError, match="at least one"):
            kind.of(empty)
