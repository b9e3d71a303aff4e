"""Tables of walks: their independent parts by several processes."""

from __future__ import annotations

import pytest

from benchmarks.walking.workers import in_order


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_parts_come_in_their_order_whatever_the_number_of_processes(jobs: int) -> None:
    assert list(in_order(abs, [-3, 1, -2, 0], jobs)) == [3, 1, 2, 0]
    failing = in_order(int, ["1", "none"], jobs)
    with pytest.raises(ValueError, match="none"):
        list(failing)
