"""`climbplan export --format regulator`: what is written, said and refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.cli.app import run


def test_command_writes_the_regulator_and_says_what_a_tick_takes(
    plans: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "regulator"
    asked = ["export", str(plans["climb"]), "--format", "regulator", "-o", str(target)]
    assert run(asked) == 0
    told = capsys.readouterr()
    assert told.out.strip() == str(target)
    assert "a tick takes" in told.err
    assert {path.name for path in target.iterdir()} == {
        "regulator.npz",
        "joint_regulator.py",
        "export.json",
    }
    with np.load(target / "regulator.npz") as stored:
        assert stored["joint_names"][0, 0] == "RF_coxa"
    assert run(asked) == 2
    assert "--force" in capsys.readouterr().err
    assert run([*asked, "--gains", "80", "--force"]) == 0  # replaces its own
    capsys.readouterr()
    assert run([*asked, "--rate", "100", "--force"]) == 2
    assert "--rate" in capsys.readouterr().err


def test_a_walk_has_no_joints_to_regulate(
    plans: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "walk")
    assert run(["export", str(plans["walk"]), "--format", "regulator", "-o", out]) == 2
    assert not Path(out).exists()
