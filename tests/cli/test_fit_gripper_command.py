"""fit-gripper on a file: what it prints and writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from command_line import RunCommand


def test_writes_model_report_and_calibration(run_command: RunCommand, workplace: Path) -> None:
    rng = np.random.default_rng(0)
    turn, friction = rng.uniform(-30, 30, (40, 3)), rng.uniform(0.3, 1.2, 40)
    force = 10 * friction * np.cos(np.deg2rad(turn[:, 0])) + rng.normal(size=40)
    rows = [
        ",".join(f"{v:.5g}" for v in (*t, mu, f))
        for t, mu, f in zip(turn, friction, force, strict=True)
    ]
    header = "alpha_deg,beta_deg,gamma_deg,friction,force_N"
    (workplace / "grips.csv").write_text("\n".join([header, *rows]))
    done = run_command("fit-gripper", "grips.csv")
    assert (done.code, done.out) == (0, "outputs/grips/gripper.json\n")
    assert "above their 95 % bound" in done.err
    folder = workplace / "outputs" / "grips"
    assert json.loads((folder / "gripper.json").read_text())["format"] == "climbplan/gripper"
    assert len(json.loads((folder / "report.json").read_text())["cross_validation"]) == 4
    assert (folder / "figures" / "calibration.png").read_bytes()[:4] == b"\x89PNG"
    refused = run_command("fit-gripper", "none.csv")
    assert refused.code == 2
    assert "none.csv: cannot be read" in refused.err
