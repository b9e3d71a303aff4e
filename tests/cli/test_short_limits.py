"""A time limit that comes during planning ends with 0, 4 or 5, whatever the kind: never with 2."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import RunCommand

ROOT = Path(__file__).parents[2]
SPECS = ROOT / "specs"
CART_POLE = ("--problem", f"{SPECS / 'cart_pole.py'}:problem")

RUNS = {
    "climb auto": ("plan-climb", "climb_steps", "--no-report"),
    "climb nlp": ("plan-climb", "climb_tube", "--no-report"),
    "climb coupled": ("plan-climb", "climb_patches", "--no-report"),
    "transition": ("plan-transition", "transition_flat", "--no-report"),
    "limms modes": ("plan-limms", "limms_throw", "--no-report"),
    "limms admm": ("plan-limms", "limms_lift_light", "--method", "admm", "--no-report"),
    "walk search": ("plan-mpc", "mpc_forward", "--no-report"),
    "walk nlp": ("plan-mpc", "mpc_forward", "--method", "mpcc", "--no-report"),
    "walk micp": ("plan-mpc", "mpc_forward", "--method", "spatial-branch-and-bound", "--no-report"),
    "walk online": ("plan-mpc", "mpc_recovery", "--no-report"),
    "shelf": ("solve-bookshelf", "bookshelf_five", "--no-report"),
    "program": ("solve", "cart_pole", *CART_POLE),
    "dataset": ("gen-data", "dataset_bookshelf", "--set", "count=2"),
}


@pytest.mark.parametrize("name", RUNS)
def test_a_limit_during_planning_is_no_bad_usage(
    name: str, tmp_path: Path, run_command: RunCommand
) -> None:
    command, spec, *further = RUNS[name]
    done = run_command(
        command, str(SPECS / f"{spec}.yaml"), *further, "--out", str(tmp_path / "out"),
        "--time-limit", "0.05", "--quiet",
    )  # fmt: skip
    assert done.code in (0, 4, 5), done.err
    if done.code == 0 and command != "gen-data":
        report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
        assert report["status"] in ("optimal", "feasible", "limit")
    if done.code == 4:
        assert done.err.startswith("error: ")
        assert "internal" not in done.err
