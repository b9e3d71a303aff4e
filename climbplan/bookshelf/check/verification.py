"""Verification of a bookshelf plan from its file alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.bookshelf.check.plan_checks import plan_checks
from climbplan.bookshelf.plan.file import read_as_found
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, worst_overlap
from climbplan.schema.holding import HeldSpec
from climbplan.verification.check import LeftOut
from climbplan.verification.held import held_against
from climbplan.verification.verification import Verification, mark_verified

_TOUCH = 1e-5  # [m] of overlap that the meaning `contact` lets pass


def verify(path: Path, held: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file; held: against another spec than its own.

    Raises PlanFileError for a file that is not a whole bookshelf plan.
    """
    return verification_of(read_as_found(path), held)


def verification_of(plan: ShelfPlan, held: HeldSpec | None = None) -> Verification:
    """As `verify`, for a plan that was read already."""
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        checks = tuple(plan_checks(plan, held))
        found = Verification(checks, against=held_against(plan, held))
        return found if found.unsound else replace(found, beyond=published_overlap(plan))


def published_overlap(plan: ShelfPlan) -> tuple[LeftOut, ...]:
    """What `meaning: published` leaves out: its separating lines let books overlap."""
    depth = worst_overlap(plan.scenes, plan.solutions.pose)[plan.solutions.placed]
    deepest = float(np.max(depth, initial=0.0))
    if plan.meaning != "published" or not deepest > _TOUCH:
        return ()
    several = len(depth) > 1
    many = f", more than {1e3 * _TOUCH:g} mm in {int((depth > _TOUCH).sum())} scenes"
    words = f"books overlap by up to {1e3 * deepest:.1f} mm{many if several else ''}"
    return (LeftOut("published meaning", words),)


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises PlanFileError for a file that is not a whole bookshelf plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
