"""Compiling does not count against limits in seconds."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SPEC = """\
kind: mpc
task: {knots: 3, integrator: mean, start: {velocity: [1, 0, 0]}}
solver: {time_limit: 3, gaits: 2}
"""


@pytest.mark.slow  # compiles everything anew
def test_first_run_of_a_fresh_install(tmp_path: Path) -> None:
    (tmp_path / "walk.yaml").write_text(SPEC)
    done = subprocess.run(
        [sys.executable, "-m", "climbplan", "plan-mpc", "walk.yaml"],
        cwd=tmp_path,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "time limit" not in done.stderr
