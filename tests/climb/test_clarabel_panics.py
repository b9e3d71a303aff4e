"""A panic inside Clarabel is an unsolved problem, not the end of a run."""

from __future__ import annotations

import os

import clarabel
import numpy as np
import pytest

from climbplan.climb.forces.clarabel import solve_with_clarabel
from climbplan.climb.forces.cones import ConicProgram


class PanicException(BaseException):
    """As PyO3 raises it."""

    __module__ = "pyo3_runtime"


class Panicking:
    def __init__(self, *problem: object) -> None:
        pass

    def solve(self) -> None:
        os.write(2, b"thread '<unnamed>' panicked\n")  # as Rust writes it
        raise PanicException("Eigval error: Eigen(1)")


class Talking(Panicking):
    def solve(self) -> str:
        os.write(2, b"a line of another thread\n")
        return "solved"


class Interrupted(Panicking):
    def solve(self) -> None:
        raise KeyboardInterrupt


def test_a_panic_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clarabel, "DefaultSolver", Panicking)
    assert solve_with_clarabel() is None
    program = ConicProgram(1)
    program.add_inequality("row", np.ones((1, 1)), np.ones(1))
    assert program.minimise(np.ones(1)) is None


def test_only_the_text_of_a_panic_is_dropped(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(clarabel, "DefaultSolver", Panicking)
    assert solve_with_clarabel() is None
    assert capfd.readouterr().err == ""
    monkeypatch.setattr(clarabel, "DefaultSolver", Talking)
    assert str(solve_with_clarabel()) == "solved"
    assert capfd.readouterr().err == "a line of another thread\n"


def test_standard_error_may_be_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(descriptor: int) -> int:
        raise OSError(f"bad file descriptor {descriptor}")

    monkeypatch.setattr(clarabel, "DefaultSolver", Panicking)
    monkeypatch.setattr(os, "dup", fail)
    monkeypatch.setattr(os, "write", lambda descriptor, text: len(text))
    assert solve_with_clarabel() is None


def test_ctrl_c_is_none_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clarabel, "DefaultSolver", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        solve_with_clarabel()
