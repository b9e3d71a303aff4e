"""An empty working directory with a small valid spec, and a way to run one command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import Outcome, RunCommand

from climbplan.cli.app import run

SMALL_CLIMB = Path(__file__).parents[1] / "schema" / "small_climb.yaml"


@pytest.fixture
def small_climb() -> str:
    """Text of a valid climb spec."""
    return SMALL_CLIMB.read_text(encoding="utf-8")


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_climb: str) -> Path:
    """A directory to run in that holds only a valid `small.yaml`."""
    place = tmp_path / "here"
    place.mkdir()
    (place / "small.yaml").write_text(small_climb, encoding="utf-8")
    monkeypatch.chdir(place)
    return place


@pytest.fixture
def run_command(workplace: Path, capsys: pytest.CaptureFixture[str]) -> RunCommand:
    """Run a command line in this process."""

    def command(*arguments: str) -> Outcome:
        code = run(arguments)
        captured = capsys.readouterr()
        return Outcome(int(code), captured.out, captured.err)

    return command
