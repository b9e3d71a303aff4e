"""Files from elsewhere: bounded in bytes and memory, and refused with what was expected."""

from __future__ import annotations

import tokenize
from pathlib import Path

import numpy as np
import pytest

from climbplan.errors import SpecError, SpecMistake, UsageError
from climbplan.reading import bounded_memory, read_bytes, read_text, reading

FAULTS = {
    "memory": (MemoryError(), "needs more than 1.5 GiB of memory, expected a table that"),
    "depth": (RecursionError("maximum depth"), "not a table (nested too deeply)"),
    "number": (OverflowError("int too large"), "not a table (int too large)"),
    "token": (tokenize.TokenError("EOF in multi-line statement", (2, 0)), "not a table ("),
    "name": (OSError(36, "Too long"), "cannot be read: Too long, expected a table"),
    "no words": (ValueError(), "not a table (ValueError)"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_what_readers_raise_becomes_one_error(name: str) -> None:
    error, words = FAULTS[name]
    with pytest.raises(UsageError) as caught, reading("t.csv", "a table"):
        raise error
    assert str(caught.value).startswith(f"t.csv: {words}")


def test_errors_that_say_what_is_wrong_pass_through() -> None:
    mine = SpecError("t.csv", [SpecMistake("a", "column is missing")])
    with pytest.raises(SpecError) as caught, reading("t.csv", "a table"):
        raise mine
    assert caught.value is mine


def test_bugs_pass_through() -> None:
    with pytest.raises(ZeroDivisionError), reading("t.csv", "a table"):
        raise ZeroDivisionError


def test_devices_without_an_end_are_read_to_the_limit() -> None:
    with pytest.raises(UsageError, match=r"larger than 0.001 MB, expected a table"):
        read_bytes(Path("/dev/zero"), 1000, "a table")


def test_text_is_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(b"\xef\xbb\xbfa,b\n")
    assert read_text(path, 100, "a table") == "a,b\n"
    path.write_bytes(b"\xff")
    with pytest.raises(UsageError, match="not UTF-8 text, expected a table"):
        read_text(path, 100, "a table")


def test_memory_is_bounded_in_the_block_alone() -> None:
    with bounded_memory(2**28):
        with pytest.raises(MemoryError):
            np.ones(2**26)
        np.ones(2**20)
    np.empty(2**26)
