"""The example notebooks: they hold no outputs, and run from the first cell to the last."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from pages import ROOT

NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
# What each notebook shows, where that is the same on every machine
SHOWN = {
    "first_climb": r">fine</b>.*force\.friction.*\(24, 6, 3\).*task\.rounds=6.*True \(1201, 85\)",
    "own_problem": r"optimal.*path.*mccormick +optimal +0\.7953.*optimal 0\.08",
    "own_robot": r"urdf: walker\.urdf.*>fine</b>.*did you mean.*in the air \[N\]: 0\.0",
}


def cells(path: Path) -> list[dict[str, Any]]:
    """The code cells of a notebook."""
    document = json.loads(path.read_text(encoding="utf-8"))
    return [cell for cell in document["cells"] if cell["cell_type"] == "code"]


def test_each_notebook_is_described_here_and_linked_in_the_docs() -> None:
    assert {path.stem for path in NOTEBOOKS} == set(SHOWN)
    page = (ROOT / "docs/notebooks.md").read_text(encoding="utf-8")
    assert all(path.name in page for path in NOTEBOOKS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_stripped(path: Path) -> None:
    for cell in cells(path):
        assert cell["outputs"] == []
        assert cell["execution_count"] is None
    assert path.stat().st_size < 20_000


@pytest.mark.filterwarnings("default")  # libraries of notebooks warn of each other
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient").NotebookClient
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=":")
    (tmp_path / "specs").symlink_to(ROOT / "specs")
    folder = tmp_path / "examples"
    folder.mkdir()
    notebook = nbformat.reads(path.read_text(encoding="utf-8"), as_version=4)
    nbformat.validate(notebook)
    place = {"metadata": {"path": str(folder)}}
    client(notebook, timeout=300, kernel_name="python3", resources=place).execute()
    shown = "\n".join(
        text
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        for text in (output.get("text", ""), *output.get("data", {}).values())
    )
    assert re.search(SHOWN[path.stem], shown, re.DOTALL), shown[:3000]
    assert list(folder.iterdir()) == []  # nothing is written beside the notebook
