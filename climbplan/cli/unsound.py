"""A word on plans that are shown or passed on although they do not hold."""

from __future__ import annotations

from pathlib import Path

from climbplan.api.kinds import PlanKind
from climbplan.cli.console import warn
from climbplan.plans.verification import Verification


def warn_of_failure(kind: PlanKind, path: Path) -> Verification:
    """Warn where a plan that is to be shown or passed on must not be used; return its checks.

    Raises:
        UnsoundPlan: its numbers mean nothing, so that nothing can be shown.
    """
    verification = kind.verify(path)
    if verification.objection:
        verification.require_sound(path)
        warn(f"{path} {verification.objection}")
    return verification
