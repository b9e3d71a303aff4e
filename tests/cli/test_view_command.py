"""`climbplan view`: what it refuses before it serves anything (the page: tests/reports)."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import h5py
import pytest
from command_line import RunCommand


def test_without_viser_it_says_what_to_install(
    run_command: RunCommand, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("plan.h5").touch()
    find = importlib.util.find_spec

    def without(name: str, *more: Any) -> Any:
        return None if name == "viser" else find(name, *more)

    monkeypatch.setattr(importlib.util, "find_spec", without)
    outcome = run_command("view", "plan.h5")
    assert (outcome.code, outcome.out) == (2, "")
    assert "pip install 'climbplan[view]'" in outcome.err


def test_files_that_cannot_be_viewed(run_command: RunCommand, workplace: Path) -> None:
    pytest.importorskip("viser")
    assert run_command("view", "nowhere").code == 2
    with h5py.File("other.h5", "w") as file:
        file.attrs["format"] = "something/else"
    outcome = run_command("view", "other.h5", "--port", "0")
    assert (outcome.code, outcome.out) == (2, "")
    assert "other.h5" in outcome.err
    assert run_command("view", "other.h5", "--port", "70000").code == 2
