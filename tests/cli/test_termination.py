"""A run that is told to end leaves nothing half done."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("command", "name"),
    [("plan-climb", "climb_region"), ("plan-transition", "mission_ground_to_top")],
)
def test_sigterm_clears_away_like_ctrl_c(tmp_path: Path, command: str, name: str) -> None:
    spec = Path(__file__).parents[2] / "specs" / f"{name}.yaml"
    line = [sys.executable, "-m", "climbplan", command, str(spec), "-o", "plan"]
    run = subprocess.Popen(line, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    begun = time.monotonic()
    while not list(tmp_path.iterdir()) and time.monotonic() - begun < 60:
        time.sleep(0.02)
    assert list(tmp_path.iterdir())  # the hidden folder that becomes the output
    run.send_signal(signal.SIGTERM)
    _, told = run.communicate(timeout=60)
    assert run.returncode == 143
    assert told.splitlines()[-1] == "terminated"
    assert not list(tmp_path.iterdir())
