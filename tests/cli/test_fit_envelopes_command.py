"""`climbplan fit-envelopes` from a spec to a file that reads back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import RunCommand

from climbplan.climb.envelopes.file import read_envelopes
from climbplan.errors import PlanFileError

SPEC = Path(__file__).parents[2] / "specs" / "envelopes_wall3.yaml"
SMALL = [
    *("-s", "data.training_feasible=10", "-s", "data.training_infeasible=3"),
    *("-s", "data.validation_feasible=4", "-s", "data.validation_infeasible=2"),
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
        assert row["feasible_count"] == 4
        assert row["infeasible_count"] == 2
        assert row["convex"] <= row["nlp"] <= 1
    assert report["conditions"]["clustering"]["meets"] > 0
    assert "P1 infeasible" in done.err
    assert "(2) excludes" in done.err
    assert {p.name for p in (out / "figures").iterdir()} == {"boxes.png", "fitness.png"}
    page = (out / "report.html").read_text()
    assert "clustering" in page
    assert "(3) projects" in page
    stored = read_envelopes(out / "envelopes.h5")
    assert stored.fingerprint == report["training_fingerprint"]
    assert stored.validation["genetic"] == report["validation"]["genetic"]
    assert stored.limb_names == ("RF", "RR", "LM")
    for box in stored.envelopes.values():
        assert box.lower.shape == (3, 6)
        assert (box.lower <= box.upper).all()


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "not.h5"
    path.write_bytes(np.zeros(64, np.uint8).tobytes())
    with pytest.raises(PlanFileError):
        read_envelopes(path)


DATA = """
kind: dataset
count: 18
seed: 3
problem:
  kind: terrains
  robot: silvia
  terrain: {distribution: wall3}
  solver: {node_limit: 4}
"""
FEW = ["-s", "fit.genetic.population=6", "-s", "fit.genetic.generations=1"]


def test_from_a_dataset_with_any_number_of_processes(
    run_command: RunCommand, workplace: Path
) -> None:
    """gen-data, data split, fit-envelopes; two envelopes a method."""
    (workplace / "terrains.yaml").write_text(DATA)
    made = run_command("gen-data", "terrains.yaml", "-o", "data")
    assert made.code == 0, made.err
    assert "verify" in made.err
    given = ["-s", "data.dataset=data/dataset.h5", "-s", "fit.envelopes=2", *FEW]
    refused = run_command("fit-envelopes", str(SPEC), *given, "-o", "none")
    assert refused.code == 2
    assert "climbplan data split" in refused.err
    assert run_command("data", "split", "data", "--test", "0.4").code == 0
    boxes = []
    for jobs in ("1", "2"):
        done = run_command("fit-envelopes", str(SPEC), *given, "-j", jobs, "-o", f"by{jobs}")
        assert done.code == 0, done.err
        boxes.append(read_envelopes(workplace / f"by{jobs}" / "envelopes.h5").envelopes)
    names = {"heuristic", "clustering-1", "clustering-2", "genetic-1", "genetic-2"}
    assert set(boxes[0]) == names
    for name in names:
        np.testing.assert_array_equal(boxes[0][name].lower, boxes[1][name].lower)
        np.testing.assert_array_equal(boxes[0][name].upper, boxes[1][name].upper)


def test_unknown_robot_is_a_mistake_of_the_spec(run_command: RunCommand, workplace: Path) -> None:
    (workplace / "terrains.yaml").write_text(DATA.replace("silvia", "silvya"))
    for command in (
        ("gen-data", "terrains.yaml"),
        ("fit-envelopes", str(SPEC), "-s", "robot=silvya"),
    ):
        done = run_command(*command)
        assert done.code == 2
        assert "silvia" in done.err
