"""Spans on a page: no negative zeros, one number where both ends are one."""

from __future__ import annotations

import pytest

from climbplan.climb.pages.page import format_millimetres


@pytest.mark.parametrize(
    ("least", "most", "words"),
    [
        (-1e-9, -1e-12, "0.0 mm"),
        (-0.0285, 0.0343, "-28.5 to 34.3 mm"),
        (-1e-6, 0.002, "0.0 to 2.0 mm"),
        (0.001, 0.00101, "1.0 mm"),
        (None, 0.1, "unknown"),
    ],
)
def test_millimetres(least: float | None, most: float | None, words: str) -> None:
    assert format_millimetres({"least": least, "most": most}) == words
