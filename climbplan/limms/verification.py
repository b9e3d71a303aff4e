"""Verification of a LIMMS plan from its file alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.limms.checker import plan_checks
from climbplan.limms.plan import LimmsPlan
from climbplan.limms.plan_file import read_as_found
from climbplan.plans.verification import Verification, mark_verified


def verify(path: Path) -> Verification:
    """Recompute all statements of the plan in a file.

    Raises PlanFileError for a file that is not a whole LIMMS plan.
    """
    return verification_of(read_as_found(path))


def verification_of(plan: LimmsPlan) -> Verification:
    """As `verify`, for a plan that was read already."""
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        return Verification(tuple(plan_checks(plan)))


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises PlanFileError for a file that is not a whole LIMMS plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
