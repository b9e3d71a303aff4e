"""`report.json` of answers to a stated program."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.store.program_file import FORMAT, FORMAT_VERSION
from climbplan.store.program_plan import ProgramPlan
from climbplan.verification.verification import Verification

_LISTED_ROWS = 1000  # beyond these the plan file has them all


def build_report(plan: ProgramPlan, verification: Verification) -> dict[str, Any]:
    """Return the report of a program's plan as JSON-ready values, without NaN and infinity.

    Args:
        plan: The plan of `climbplan solve`.
        verification: Its verification.

    Returns:
        The plan's attributes, the checks and the outcome of each row.
    """
    answered = plan.objective[plan.found]
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "name": plan.name,
        "problem": plan.problem,
        "status": plan.overall,
        "verified": verification.passed,
        **verification.scope(),
        "objective": _replace_infinite(plan.total),
        "bound": _replace_infinite(plan.total_bound),
        "seed": plan.seed,
        "spec_sha256": plan.spec_sha256,
        "rows": {
            "count": plan.count,
            "answered": int(plan.found.sum()),
            "mean_objective": _replace_infinite(float(answered.mean()) if len(answered) else None),
            "mean_time": _replace_infinite(float(plan.time.mean())),
            "worst_time": _replace_infinite(float(plan.time.max())),
        },
        "results": [_build_row(plan, k) for k in range(min(plan.count, _LISTED_ROWS))],
        "verification": verification.as_dict(),
        "timings": dict(plan.timings),
        "solvers": dict(plan.solvers),
        "sizes": dict(plan.sizes),
    }


def write_report(report: dict[str, Any], directory: Path) -> None:
    """Write `report.json` into a directory."""
    text = json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False)
    (directory / "report.json").write_text(text + "\n", encoding="utf-8")


def _build_row(plan: ProgramPlan, k: int) -> dict[str, Any]:
    blocks = {
        block.name: plan.x[k, block.start : block.stop].reshape(block.shape).tolist()
        for block in plan.layouts.variables
    }
    row: dict[str, Any] = {
        "status": plan.status[k],
        "objective": _replace_infinite(float(plan.objective[k])),
        "bound": _replace_infinite(float(plan.bound[k])),
        "gap": _replace_infinite(float(plan.gap[k])),
        "time": _replace_infinite(float(plan.time[k])),
        "method": plan.method[k],
        "winner": plan.winner[k],
        "tried": int(plan.tried[k]),
    }
    # One row is read by people; of many the plan file has the numbers.
    if plan.count == 1 and plan.found[k] and np.isfinite(plan.x[k]).all():
        row["variables"] = blocks
    return row


def _replace_infinite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
