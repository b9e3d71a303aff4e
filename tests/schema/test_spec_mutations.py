"""Whatever happens to a spec, loading it ends in a spec or in mistakes, never in a bug."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.schema.yaml_source import parse_yaml, write_yaml

SMALL_CLIMB = Path(__file__).with_name("small_climb.yaml")
TEXT = SMALL_CLIMB.read_text(encoding="utf-8")

# Every example overwrites the one file in `tmp_path`.
SAME_FILE = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

ODD_VALUES: list[Any] = [
    None, True, 0, -1, 1e300, 10**30, float("nan"), float("inf"), "", "x", "1 mm", [], {}, [[]],
    [None], {"a": 1}, [1, 2, 3], "silvia.yaml", "../../etc/passwd", "\u00e9", "a" * 500,
]  # fmt: skip


def outcome(path: Path, text: str) -> str:
    """What loading says: nothing, or the mistakes."""
    path.write_text(text, encoding="utf-8")
    try:
        load_climb(path)
    except SpecError as error:
        return str(error)
    return ""


def places(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Every key path of plain data."""
    below = value.items() if isinstance(value, dict) else enumerate(value)
    found: list[tuple[str | int, ...]] = []
    for key, item in below:
        found.append((*path, key))
        if isinstance(item, dict | list):
            found += places(item, (*path, key))
    return found


PLACES = places(parse_yaml(TEXT, "f").value)


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.sampled_from(PLACES), st.sampled_from(ODD_VALUES))
def test_any_value_in_any_place(tmp_path: Path, place: tuple[str | int, ...], value: Any) -> None:
    data = parse_yaml(TEXT, "f").value
    holder = data
    for segment in place[:-1]:
        holder = holder[segment]
    holder[place[-1]] = value
    said = outcome(tmp_path / "s.yaml", write_yaml(data))
    if said:
        assert "Input should" not in said  # pydantic's own words
        assert "Value error" not in said


@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.integers(0, len(TEXT) - 1),
    st.integers(0, 30),
    st.text(st.sampled_from(list(" \n\t:-[]{}#&*!|>'\"%@`,?0a.")), max_size=6),
)
def test_any_slip_of_the_pen(tmp_path: Path, start: int, length: int, typed: str) -> None:
    outcome(tmp_path / "s.yaml", TEXT[:start] + typed + TEXT[start + length :])


@pytest.mark.parametrize("number", range(TEXT.count("\n")))
def test_any_line_left_out(tmp_path: Path, number: int) -> None:
    lines = TEXT.splitlines(keepends=True)
    outcome(tmp_path / "s.yaml", "".join(lines[:number] + lines[number + 1 :]))
