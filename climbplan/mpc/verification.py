"""Verification of an MPC plan from its file alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.mpc.plan_checks import plan_checks
from climbplan.mpc.plan_file import read_as_found
from climbplan.plans.verification import Verification, mark_verified


def verify(path: Path) -> Verification:
    """Recompute all statements of the plan in a file.

    Raises PlanFileError for a file that is not a whole MPC plan.
    """
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        return Verification(tuple(plan_checks(read_as_found(path))))


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it."""
    verification = verify(path)
    mark_verified(path, verification)
    return verification
