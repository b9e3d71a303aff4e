"""The tree keeps its shape: imports point down, nothing loads code from data."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

ROOT = Path(__file__).parents[1]
SOURCES = sorted(p for part in ("climbplan", "benchmarks") for p in (ROOT / part).rglob("*.py"))
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


def test_no_code_from_data_and_no_huge_files() -> None:
    wrong = []
    for path in SOURCES:
        text = path.read_text()
        wrong += [f"{path}: {pattern}" for pattern in FORBIDDEN if re.search(pattern, text)]
        if (lines := len(text.splitlines())) > 500:
            wrong.append(f"{path}: {lines} lines")
    assert not wrong


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


def test_files_are_more_than_fragments_of_another() -> None:
    """A file below 60 lines that one neighbour alone imports belongs into it."""
    first = "climbplan.cli.environment"  # runs before NumPy is loaded
    texts = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path.read_text()
        for path in SOURCES
        if path.name != "__init__.py" and path.relative_to(ROOT).parts[0] == "climbplan"
    }
    importers: dict[str, set[str]] = {module: set() for module in texts}
    for importer, text in texts.items():
        for package, names in re.findall(r"from ([\w.]+) import (\([^)]*\)|[^\n]*)", text):
            for module in (package, *(f"{package}.{name}" for name in re.findall(r"\w+", names))):
                importers.get(module, set()).add(importer)
        for module in re.findall(r'"(climbplan\.[\w.]+)[:"]', text):  # imported by name
            importers.get(module, set()).add("")
    fragments = [
        f"{module}: only for {next(iter(found))}"
        for module, found in importers.items()
        if module != first
        and len(texts[module].splitlines()) < 60
        and len(found) == 1
        and next(iter(found)).rpartition(".")[0] == module.rpartition(".")[0]
    ]
    assert not fragments
