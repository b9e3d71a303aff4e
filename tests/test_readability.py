"""Names, docstrings and commit subjects: counts of what is hard to read may only fall."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from readability import MAX_SUBJECT, RECORD, SUBJECT, count_package

ROOT = Path(__file__).parents[1]
LAST_COMMITS = 20


def test_the_package_reads_no_worse_than_recorded() -> None:
    recorded = json.loads(RECORD.read_text(encoding="utf-8"))
    worse = {
        name: f"{count}, recorded {recorded[name]}"
        for name, count in count_package().items()
        if count > recorded[name]
    }
    assert not worse, f"{worse}: see the rules for names and docstrings in CONTRIBUTING.md"


def test_what_is_hard_to_read_is_counted(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(
        'class Box:\n    pass\n\n\ndef drawn(found, a, b, c, d, e, f):\n    """Of a fall."""\n'
        + "    pass\n" * 61
    )
    (tmp_path / "b.py").write_text("class Box:\n    here = 1\n")
    assert count_package(tmp_path) == {
        "fragment_docstrings": 1,
        "long_functions": 1,
        "participle_functions": 1,
        "shared_class_names": 1,
        "vague_names": 3,
        "wide_functions": 1,
    }


def test_subjects_of_the_last_commits_say_area_and_change() -> None:
    try:
        log = subprocess.run(
            ["git", "log", "--no-merges", f"-{LAST_COMMITS}", "--format=%s"],
            cwd=ROOT, capture_output=True, text=True, check=True,
        )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no git history here")
    wrong = [
        subject
        for subject in log.stdout.splitlines()
        if len(subject) > MAX_SUBJECT or not SUBJECT.match(subject)
    ]
    assert not wrong, f"expected `area: imperative`, at most {MAX_SUBJECT} characters: {wrong}"
