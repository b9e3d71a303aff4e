"""What `solve --certificate` says of bounds that are proved."""

from __future__ import annotations

import math

import pytest

from climbplan.methods.certified_rows import is_weaker_than_search


@pytest.mark.parametrize(
    ("proved", "searched", "less"),
    [
        (-2.2e-13, -8.9e-16, False),  # an optimum of 0, off by rounding
        (9.9995, 10.0, False),  # within the gap
        (9.9, 10.0, True),
        (-1e-6, 0.0, True),
        (10.1, 10.0, False),
        (5.0, math.inf, True),  # that nothing is feasible is not proved
        (math.inf, math.inf, False),
        (5.0, -math.inf, False),  # the search had no bound
    ],
)
def test_a_certificate_proves_less_by_more_than_rounding_and_gap(
    proved: float, searched: float, less: bool
) -> None:
    assert is_weaker_than_search(proved, searched, 1e-4) == less
