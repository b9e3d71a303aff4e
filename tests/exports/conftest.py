"""Plans of every kind that moves, made once."""

from __future__ import annotations

from pathlib import Path

import pytest
from short_climb import SHORT_CLIMB

import climbplan

SPECS = Path(__file__).parents[2] / "specs"


@pytest.fixture(scope="session")
def plans(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Plan files of a climb, a walk and a delivery by modules."""
    place = tmp_path_factory.mktemp("plans")
    specs = {
        "climb": climbplan.load(SHORT_CLIMB),
        "walk": climbplan.load(SPECS / "mpc_forward.yaml", set={"task.knots": 6}),
        "modules": climbplan.load(SPECS / "limms_throw.yaml"),
    }
    found = {}
    for name, spec in specs.items():
        found[name] = place / f"{name}.h5"
        climbplan.plan(spec).save(found[name])
    return found
