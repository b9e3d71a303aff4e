"""The line that tells of compilation."""

from __future__ import annotations

import numba
import pytest

from climbplan.cli.compiling import compiling_told
from climbplan.cli.console import Session


def test_compilation_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    one, other = numba.njit(lambda x: x + 1), numba.njit(lambda x: x - 1)
    with compiling_told(Session()):
        assert (one(1), other(1)) == (2, 0)
    assert capsys.readouterr().err.count("compiling functions") == 1
    with compiling_told(Session()):
        one(2)  # is there already
    assert capsys.readouterr().err == ""
    one(1.0)  # compiled anew, outside
    assert capsys.readouterr().err == ""
    with compiling_told(Session(quiet=True)):
        other(1.0)
    assert capsys.readouterr().err == ""
