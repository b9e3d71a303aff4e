"""YAML reading: values, lines, mistakes, and what must not happen to a reader."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from climbplan.errors import SpecError
from climbplan.schema.yaml_source import parse_yaml, write_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("1E5", 1e5),
        ("-2.5e+2", -250.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        ("+4", 4),
        ("true", True),
        ("False", False),
        ("yes", "yes"),
        ("off", "off"),
        ("~", None),
        ("", None),
        ("null", None),
        ("1:30", "1:30"),
        ("2024-01-01", "2024-01-01"),
        ("1_000", "1_000"),
        ("'1'", "1"),
        ("!!str 12", "12"),
        ("!!float 3", 3.0),
        ("1230 mm", "1230 mm"),
        ("=", "="),
        ("-.inf", -math.inf),
    ],
)
def test_scalars_are_read_as_people_expect(text: str, value: Any) -> None:
    parsed = parse_yaml(f"x: {text}\n", "f").value["x"]
    assert parsed == value
    assert type(parsed) is type(value)


def test_nan_is_read() -> None:
    assert math.isnan(parse_yaml("x: .nan", "f").value["x"])


def test_every_value_has_its_line() -> None:
    document = parse_yaml("a: 1\nb:\n  c:\n    - 1\n    - {d: 2}\n", "f")
    assert document.lines == {
        (): 1,
        ("a",): 1,
        ("b",): 2,
        ("b", "c"): 3,
        ("b", "c", 0): 4,
        ("b", "c", 1): 5,
        ("b", "c", 1, "d"): 5,
    }


def test_aliases_and_merged_keys() -> None:
    document = parse_yaml("a: &a {x: 1, y: 2}\nb:\n  <<: *a\n  y: 3\nc: *a\n", "f")
    assert document.value["b"] == {"x": 1, "y": 3}
    assert document.value["c"] == {"x": 1, "y": 2}
    assert document.value["c"] is not document.value["a"]  # setting one must not set the other
    assert document.lines["b", "x"] == 1
    assert document.lines["b", "y"] == 4


@pytest.mark.parametrize(
    ("text", "key", "fragment"),
    [
        ("a: !!python/object/apply:os.system [ls]", ("a",), "!!python/object/apply:os.system"),
        ("a: !robot {x: 1}", ("a",), "!robot"),
        ("a: !!set {x, y}", ("a",), "!!set"),
        ("a: !!binary aGVsbG8=", ("a",), "!!binary"),
        ("a: !!timestamp 2024-01-01", ("a",), "!!timestamp"),
        ("a: !!int three", ("a",), "does not fit"),
        ("a: 1\nb: 2\na: 3", ("a",), "twice, on lines 1 and 3"),
        ("a: {[1]: 2}", ("a",), "plain text"),
        ("a: {<<: 3}", ("a",), "<<"),
        ('a: "x\\x1by"', ("a",), "control character"),
        ('a: "\\ud800"', ("a",), "control character"),
        ('a: "\\0"', ("a",), "control character"),
        ("a: " + "9" * 5000, ("a",), "5000 digits"),
    ],
)
def test_mistakes_that_leave_the_rest_readable(
    text: str, key: tuple[str, ...], fragment: str
) -> None:
    document = parse_yaml(f"{text}\nz: 5\n", "f")
    assert document.value["z"] == 5
    assert [f.path for f in document.findings] == [key]
    assert fragment in document.findings[0].message


BOMB = "a0: &a0 [0]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
)
CHAIN = "a0: &a0 [0]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 2000))
MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 40)
)
# Few nodes, but millions of entries to be copied
MERGED_OFTEN = (
    "b: &b {" + ", ".join(f"k{i}: 1" for i in range(3000)) + "}\n"
    f"a: {{<<: [{', '.join(['*b'] * 3000)}]}}\n"
)
MERGED_ONWARD = "a0: &a0 {" + ", ".join(f"k{i}: 1" for i in range(4000)) + "}\n"
MERGED_ONWARD += "".join(f"a{i}: &a{i} {{<<: *a{i - 1}}}\n" for i in range(1, 60))


@pytest.mark.parametrize(
    "text",
    ["9" * 399, "-" + "9" * 320, "0x" + "f" * 300, "0o" + "7" * 380, "9" * 5000, "0x" + "f" * 5000,
     "!!int 1_000", "!!int 0b11", "!!int 1:30", "!!int \uff14", "!!float 1_0", "!!float nan",
     "!!float infinity", "!!float " + "9" * 5000, "!!bool yes", "!!int", "!!null x"],
)  # fmt: skip
def test_numbers_that_are_none(text: str) -> None:
    """Refused with their line, whether or not Python could make something of them."""
    document = parse_yaml(f"a: 1\nx: {text}\n", "f")
    (mistake,) = document.mistakes(document.findings)
    assert mistake.line == 2
    assert re.search("a number of [0-9]+ digits|does not fit its YAML tag", mistake.message)
    assert len(mistake.message) < 200


def test_mistakes_are_counted_only_so_far() -> None:
    assert len(parse_yaml("a: 1\n" * 20_000, "f").findings) == 1000


@pytest.mark.parametrize(
    ("text", "line", "fragment"),
    [
        ("a: 1\n\tb: 2\n", 2, "tab"),
        ("a: 1\nb\nc: 2\n", 3, "without ':'"),
        ("a: [1, 2\nb: 3\n", 2, "]"),
        ("a: b: c\n", 1, "':'"),
        ("a: 1\n---\nb: 2\n", 2, "second document"),
        ("a: *b\n", 1, "alias"),
        ("a: 'x\n", None, "quote"),
        ("a: 1\n b: 2\n", 2, "indentation"),
        ('a: 1\nb: "\\Uffffffff"\n', 2, "out of range"),
        ("a: 1\nb: \x07\n", 2, "control character"),
        ("a: " + "[" * 100_000, 1, "nested deeper"),
        ("a: " + "{x: " * 10_000, 1, "nested deeper"),
        ("a:\n" + "".join(" " * i + "-\n" for i in range(1, 400)), None, "nested deeper"),
        ("a: &a [*a]\n", 1, "nested deeper"),
        ("a: &a {<<: *a}\n", 1, "nested deeper"),
        (CHAIN, None, "nested deeper"),
        (BOMB, None, "aliases"),
        (MERGES, None, "aliases"),
        (MERGED_OFTEN, None, "aliases"),
        (MERGED_ONWARD, None, "aliases"),
        ("x" * 5_000_001, None, "too large: 5.0 million characters"),
        ("%YAML " + "1" * 5000 + ".1\n---\na: 1\n", 1, "not valid YAML"),
    ],
)
def test_text_that_is_no_spec(text: str, line: int | None, fragment: str) -> None:
    with pytest.raises(SpecError) as caught:
        parse_yaml(text, "f")
    (mistake,) = caught.value.mistakes
    assert fragment in mistake.message
    if line is not None:
        assert mistake.line == line


_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=("Cc", "Cs", "Cn"), max_codepoint=0xFFFD))
    | st.sampled_from(["yes", "no", "on", "1e-3", "010", "~", "1:30", "=", "<<", "0x1f", ".nan"]),
    lambda below: st.lists(below) | st.dictionaries(st.sampled_from("abcdef"), below),
    max_leaves=20,
)


@given(_VALUES)
def test_written_yaml_reads_back_the_same(value: Any) -> None:
    read = parse_yaml(write_yaml({"x": value}), "f")
    assert read.findings == []
    assert read.value == {"x": value}


@given(st.text(st.characters(exclude_categories=("Cs",)), max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    with suppress(SpecError):  # and nothing else
        parse_yaml(text, "f")
