"""`export --instances` as its users type it."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from command_line import RunCommand

from climbplan.instances import families

_SMALL = ("cart-poles", "free-flyers")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two families that are drawn in no time."""
    kept = tuple(f for f in families.FAMILIES if f.name in _SMALL)
    monkeypatch.setattr(families, "FAMILIES", kept)


def _table(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


@pytest.mark.usefixtures("few")
def test_export_writes_the_set_and_its_path(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("export", "--instances", "set", "--count", "1")
    assert (done.code, done.out) == (0, "set\n")
    assert "6 instances, seed 0" in done.err
    rows = _table(workplace / "set" / "instances.csv")
    assert len(rows) == 6
    assert all((workplace / "set" / row["file"]).stat().st_size > 0 for row in rows)
    assert (workplace / "set" / "check_solution.py").exists()
    again = run_command("export", "--instances", "set", "--count", "1")
    assert again.code == 2
    assert "--force" in again.err
    first = (workplace / "set" / rows[0]["file"]).read_text()
    other = run_command("export", "--instances", "set", "--count", "1", "--seed", "7", "--force")
    assert other.code == 0
    changed = workplace / "set" / rows[0]["file"]
    assert changed.read_text() != first
    # Best values are known of seed 0 alone, and are claimed of no other
    assert not any(row["best_known"] for row in _table(workplace / "set" / "instances.csv"))


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--instances", "set", "--rate", "100"), "--instances DIR: expected no PLAN"),
        (("plan.h5", "--instances", "set"), "--instances DIR: expected no PLAN"),
        (("plan.h5", "--count", "2"), "--seed and --count go with --instances"),
        (("--seed", "2"), "expected a PLAN"),
        (("--instances", "set", "--count", "0"), "--count"),
    ],
)
def test_export_refuses_what_does_not_go_together(
    run_command: RunCommand, workplace: Path, options: tuple[str, ...], word: str
) -> None:
    outcome = run_command("export", *options)
    assert outcome.code == 2
    assert outcome.out == ""
    assert word in outcome.err
    assert not (workplace / "set").exists()
