"""`climbplan fit-envelopes` from a spec to a file that reads back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import RunCommand

from climbplan.coupled.envelope_file import read_envelopes
from climbplan.errors import PlanFileError

SPEC = Path(__file__).parents[2] / "specs" / "envelopes_wall3.yaml"
SMALL = [
    *("-s", "data.training_feasible=12", "-s", "data.training_infeasible=6"),
    *("-s", "data.validation_feasible=8", "-s", "data.validation_infeasible=4"),
    *("-s", "fit.genetic.population=6", "-s", "fit.genetic.generations=2"),
    *("-s", "fit.genetic.terrains=6"),
]


def test_small_run(run_command: RunCommand, tmp_path: Path) -> None:
    out = tmp_path / "wall"
    done = run_command("fit-envelopes", str(SPEC), *SMALL, "-o", str(out), "--json")
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert set(report["validation"]) == {"clustering", "genetic", "heuristic"}
    for row in report["validation"].values():
        assert row["feasible_count"] == 8
        assert row["infeasible_count"] == 4
        assert row["convex"] <= row["nlp"] <= 1
    assert report["conditions"]["clustering"]["meets"] > 0
    assert "P1 infeasible" in done.err
    stored = read_envelopes(out / "envelopes.h5")
    assert stored.limb_names == ("RF", "RR", "LM")
    for box in stored.envelopes.values():
        assert box.lower.shape == (3, 6)
        assert (box.lower <= box.upper).all()


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "not.h5"
    path.write_bytes(np.zeros(64, np.uint8).tobytes())
    with pytest.raises(PlanFileError):
        read_envelopes(path)
