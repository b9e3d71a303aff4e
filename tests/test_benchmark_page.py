"""The page of benchmarks is made from records that runs write."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from pages import ROOT

from benchmarks.record import describe_start, make_record

TABLES = """force problems of a climb
method        seconds  ratio
ours            0.010    1.0
clarabel | x    0.031    3.1
"""


def test_a_record_becomes_a_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs" / "_ext")
    from benchmark_page import benchmarks_page

    record = make_record(describe_start(), "force", {"quick": True, "seed": 3}, {}, TABLES)
    (tmp_path / "force.json").write_text(json.dumps(record), encoding="utf-8")
    page = benchmarks_page(tmp_path)
    assert "`python -m benchmarks force --quick --seed 3`" in page
    assert "| method | seconds | ratio |" in page
    assert "| clarabel \\| x | 0.031 | 3.1 |" in page
    assert f"python {sys.version.split()[0]}" in page
    assert record["date"][:10] in page


def test_records_of_the_site_are_of_benchmarks_that_there_are() -> None:
    from benchmarks.app import app

    names = {command.name for command in app.registered_commands}
    for path in (ROOT / "docs" / "benchmarks").glob("*.json"):
        record = json.loads(path.read_text(encoding="utf-8"))
        assert record["benchmark"] == path.stem
        assert record["benchmark"] in names
        assert record["commit"] is not None
        assert not record["commit"].endswith("-dirty")
