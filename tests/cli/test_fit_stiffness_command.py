"""fit-stiffness on a file: what it prints and writes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

from command_line import RunCommand

SHIPPED = Path(__file__).parents[2] / "specs" / "limb_test.csv"


def test_writes_matrices_report_and_figure(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("fit-stiffness", str(SHIPPED), "--out", "limb")
    assert (done.code, done.out) == (0, "limb/stiffness.csv\n")
    assert "femur: " in done.err
    report = json.loads((workplace / "limb" / "report.json").read_text())
    assert report["best"]["joint_stiffness"]["tibia"]["told"]
    rows = list(csv.DictReader((workplace / "limb" / "stiffness.csv").read_text().splitlines()))
    assert len(rows) == report["matrices"]
    assert (workplace / "limb" / "figures" / "stiffness.png").read_bytes()[:4] == b"\x89PNG"
    # The table that was written is itself a file of measurements.
    again = run_command("fit-stiffness", "limb/stiffness.csv", "--out", "again", "--json")
    assert again.code == 0
    value = json.loads(again.out)["best"]["joint_stiffness"]["tibia"]["value"]
    assert abs(value / report["best"]["joint_stiffness"]["tibia"]["value"] - 1) < 0.05
    assert run_command("fit-stiffness", str(SHIPPED), "--out", "limb").code == 2


def test_refusals(run_command: RunCommand, workplace: Path) -> None:
    missing = run_command("fit-stiffness", "none.csv")
    assert missing.code == 2
    assert "none.csv: cannot be read" in missing.err
    (workplace / "odd.csv").write_text("a,b\n1,2\n")
    odd = run_command("fit-stiffness", "odd.csv")
    assert odd.code == 2
    assert "column is missing" in odd.err
    assert not (workplace / "outputs").exists()
