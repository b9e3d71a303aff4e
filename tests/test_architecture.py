"""The tree keeps its shape: imports point down, nothing loads code from data."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "climbplan").rglob("*.py"))
FORBIDDEN = (
    r"\bpickle\b",
    r"yaml\.load\(",
    r"(?<![\w.])(?<!def )eval\(",
    r"(?<![\w.])exec\(",
)


def test_imports_point_down(monkeypatch: pytest.MonkeyPatch) -> None:
    cli = pytest.importorskip("importlinter.cli")
    monkeypatch.chdir(ROOT)
    assert cli.lint_imports(no_cache=True) == 0


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_code_from_data_and_no_huge_files(path: Path) -> None:
    text = path.read_text()
    for forbidden in (
        r"\bpickle\b",
        r"yaml\.load\(",
        r"(?<![\w.])(?<!def )eval\(",
        r"(?<![\w.])exec\(",
    ):
        assert not re.search(forbidden, text), f"{path}: {forbidden}"
    assert len(text.splitlines()) <= 500


def test_matrices_are_computed_as_by_commands() -> None:
    """NumPy was loaded after the command line had asked for one thread, or the user for others."""
    asked = int(os.environ["OPENBLAS_NUM_THREADS"])
    assert np.linalg.norm(np.eye(2)) > 0
    pools = [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]
    assert pools
    assert set(pools) == {asked}


def test_no_catch_all_rooms() -> None:
    names = {p.stem for p in SOURCES} | {p.parent.name for p in SOURCES}
    assert not names & {"utils", "common", "helpers", "misc", "util"}
