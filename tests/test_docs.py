"""The site's tutorials and the examples run as printed; its pages name what there is."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from pages import ROOT, blocks, missing_lines, run, script_of

DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


def start(folder: Path) -> None:
    """What a reader in a clone of the repository has."""
    (folder / "specs").symlink_to(ROOT / "specs")
    (folder / "examples").symlink_to(ROOT / "examples")


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_tutorial_runs_and_prints_what_it_shows(page: Path, tmp_path: Path) -> None:
    start(tmp_path)
    text = page.read_text()
    (tmp_path / "page.py").write_text(script_of(text))
    done = run("python page.py", tmp_path)
    assert done.returncode == 0, done.stderr
    assert not missing_lines(text, done.stdout), done.stdout
