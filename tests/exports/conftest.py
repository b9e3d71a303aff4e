"""Plans of every kind that moves, made once."""

from __future__ import annotations

from pathlib import Path

import pytest

import climbplan

SPECS = Path(__file__).parents[2] / "specs"
CLIMB = """
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.4]}
task:
  rounds: 1
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.05]}
force: {normal_force_weight: 2.0e-4}
"""


@pytest.fixture(scope="session")
def plans(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Plan files of a climb, a walk and a delivery by modules."""
    place = tmp_path_factory.mktemp("plans")
    specs = {
        "climb": climbplan.load(CLIMB),
        "walk": climbplan.load(SPECS / "mpc_forward.yaml", set={"task.knots": 6}),
        "modules": climbplan.load(SPECS / "limms_throw.yaml"),
    }
    found = {}
    for name, spec in specs.items():
        found[name] = place / f"{name}.h5"
        climbplan.plan(spec).save(found[name])
    return found
