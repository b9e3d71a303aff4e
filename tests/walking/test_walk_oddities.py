"""Speeds and goals of walks that hardly fit the robot are warned of by their keys."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.api.validating import check_spec
from climbplan.schema.loading import load_spec

SPECS = Path(__file__).parents[2] / "specs"


@pytest.mark.parametrize("path", sorted(SPECS.glob("mpc_*.yaml")), ids=lambda path: path.stem)
def test_shipped_walks_fit_their_robots(path: Path) -> None:
    assert check_spec(load_spec(path)).warnings == ()


@pytest.mark.parametrize(
    ("override", "start"),
    [
        ("task.reference.velocity=[1800, 0, 0]", "task.reference.velocity: 1800 m/s"),
        ("task.goal.position=[400, 0]", "task.goal.position: 400 m away"),
        ("task.reference.height=0.9", "task.reference.height: 0.9 m"),
    ],
)
def test_figures_out_of_proportion_are_warned_of(override: str, start: str) -> None:
    (line,) = check_spec(load_spec(SPECS / "mpc_stones.yaml", [override])).warnings
    assert line.startswith(start)
    assert "legs of SCALER are 0.19 m long" in line
