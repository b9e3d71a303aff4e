"""A word on plans that are shown or passed on although they do not hold."""

from __future__ import annotations

from pathlib import Path

from climbplan.api.kinds import PlanKind
from climbplan.cli.console import warn
from climbplan.plans.verification import Verification


def warn_of_failure(kind: PlanKind, path: Path) -> Verification:
    """Say that a plan which is to be shown or passed on does not hold; what its checks come to.

    Raises:
        UnsoundPlan: its numbers mean nothing, so that nothing can be shown.
    """
    verification = kind.verify(path)
    if not verification.passed:
        verification.require_sound(path)
        warn(f"{path} fails its verification: {verification.headline()}")
    return verification
