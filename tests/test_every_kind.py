"""Every kind of plan goes from its spec to a verified file, a page, tables and a simulation."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from scenes import SCENES, PlannedScenes

from climbplan.cli.app import run


@pytest.fixture(scope="session", params=SCENES)
def plan(request: pytest.FixtureRequest, planned_scenes: PlannedScenes) -> Path:
    """The plan file of each kind."""
    return planned_scenes[request.param]


@pytest.fixture(scope="session", params=[name for name in SCENES if name != "bookshelf"])
def motion(request: pytest.FixtureRequest, planned_scenes: PlannedScenes) -> Path:
    """The plan file of each kind in which something moves."""
    return planned_scenes[request.param]


def test_it_is_verified_from_its_file_alone(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copy(plan, tmp_path / "plan.h5")
    assert run(["verify", str(copy), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["passed"]


def test_it_has_a_page_and_numbers(plan: Path) -> None:
    folder = plan.parent
    assert "</html>" in (folder / "report.html").read_text(encoding="utf-8")
    assert json.loads((folder / "report.json").read_text(encoding="utf-8"))["verified"]
    assert list((folder / "figures").iterdir())


def test_it_is_exported_as_a_table(motion: Path, tmp_path: Path) -> None:
    table = tmp_path / "plan.csv"
    assert run(["export", str(motion), "--format", "csv", "-o", str(table)]) == 0
    rows = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    assert len(rows) > 5
    assert len({row.count(",") for row in rows}) == 1


def test_it_is_simulated(motion: Path, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    assert run(["simulate", str(motion), "-o", str(tmp_path / "simulated"), "--json"]) == 0
    assert (tmp_path / "simulated").is_dir()
