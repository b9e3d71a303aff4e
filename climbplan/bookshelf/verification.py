"""Verification of a bookshelf plan from its file alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.bookshelf.plan import ShelfPlan
from climbplan.bookshelf.plan_checks import plan_checks
from climbplan.bookshelf.plan_file import read_as_found
from climbplan.plans.held import held_against
from climbplan.plans.verification import Verification, mark_verified
from climbplan.spec.holding import HeldSpec


def verify(path: Path, held: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file; held: against another spec than its own.

    Raises PlanFileError for a file that is not a whole bookshelf plan.
    """
    return verification_of(read_as_found(path), held)


def verification_of(plan: ShelfPlan, held: HeldSpec | None = None) -> Verification:
    """As `verify`, for a plan that was read already."""
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        return Verification(tuple(plan_checks(plan, held)), against=held_against(plan, held))


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises PlanFileError for a file that is not a whole bookshelf plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
