"""`climbplan verify --worlds`: falls counted again in the worlds that a plan file names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from climbplan.errors import UsageError
from climbplan.verification.check import judge

if TYPE_CHECKING:
    from climbplan.verification.verification import Verification


_NO_WORLDS = (
    "names no worlds; climbs and transitions do whose spec or robot file states `uncertainty`, or "
    "whose spec states `risk`"
)


def require_climb(path: Path) -> None:
    """Raise UsageError for a file that is no climb or transition, whose worlds none could count."""
    from climbplan.climb.plan.layout import FORMATS
    from climbplan.store.plan_format import read_plan_format

    if read_plan_format(path) not in FORMATS.values():
        raise UsageError(f"--worlds: {path} {_NO_WORLDS}")


def recount_worlds(path: Path, verification: Verification) -> Verification:
    """Return the verification with one check more: the stored falls against those counted again.

    Args:
        path: The plan file.
        verification: What its checks came to; returned as it is for unsound plans.

    Raises:
        UsageError: The file names no worlds.
    """
    if verification.unsound is not None:
        return verification
    from climbplan.climb.plan.file import read_climb
    from climbplan.climb.simulation.risk.estimation import estimate_risk
    from climbplan.simulation.conditions import Conditions

    plan = read_climb(path)
    stored = plan.promise or plan.sample
    if stored is None:
        raise UsageError(f"--worlds: {path} {_NO_WORLDS}")
    engine: Literal["mujoco", "statics"] = "statics" if stored.engine == "statics" else "mujoco"
    base = Conditions(closed_loop=plan.promise is not None and plan.promise.closed_loop)
    judged = estimate_risk(plan, base, engine, stored.worlds, stored.seed)
    off = abs(judged.falls - stored.falls) / stored.worlds
    mismatch = f"{judged.falls} of {stored.worlds} fall, stored {stored.falls}"
    check = judge("robust.recount", off, margin=mismatch)
    return replace(verification, checks=(*verification.checks, check))
