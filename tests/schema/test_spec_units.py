"""Numbers that people write with units."""

from __future__ import annotations

import pytest

from climbplan.schema.wording import parse_quantity


@pytest.mark.parametrize(
    ("text", "unit", "number"),
    [
        ("1230 mm", "m", 1.23),
        ("1230mm", "m", 1.23),
        ("1,23", "m", 1.23),
        ("1e3 mm", "m", 1.0),
        ("-4 cm", "m", -0.04),
        ("0.5 rad", "deg", 28.64788975654116),
        ("180°", "rad", 3.141592653589793),
        ("800 g", "kg", 0.8),
        ("20 cm/min", "m/s", 0.2 / 60),
        ("25 Nm", "N m", 25.0),
        ("80 %", "", 0.8),
        ("3", "kg", 3.0),
        ("3 m", "kg", None),
        ("wide", "m", None),
        ("1.2.3", "m", None),
        ("", "m", None),
    ],
)
def test_meant_numbers(text: str, unit: str, number: float | None) -> None:
    assert parse_quantity(text, unit) == (None if number is None else pytest.approx(number))
