"""Verification of a bookshelf plan from its file alone.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.bookshelf.check.plan_checks import check_plan
from climbplan.bookshelf.plan.file import read_unchecked_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, measure_worst_overlap
from climbplan.schema.holding import HeldSpec
from climbplan.verification.check import LeftOut
from climbplan.verification.held import describe_reference
from climbplan.verification.verification import Verification, mark_verified

_TOUCH = 1e-5  # [m] of overlap that the meaning `contact` lets pass


def verify(path: Path, replacement_spec: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file.

    Args:
        path: the plan file.
        replacement_spec: a spec that the plan is compared with in place of its own.

    Raises:
        PlanFileError: the file is not a whole bookshelf plan.
    """
    return verify_plan(read_unchecked_plan(path), replacement_spec)


def verify_plan(plan: ShelfPlan, replacement_spec: HeldSpec | None = None) -> Verification:
    """Recompute all statements of a plan in memory; `replacement_spec` replaces its own spec."""
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        checks = tuple(check_plan(plan, replacement_spec))
        verification = Verification(
            checks, against=describe_reference(plan, replacement_spec), is_motion=False
        )
        return (
            verification
            if verification.unsound
            else replace(verification, beyond=report_published_overlap(plan))
        )


def report_published_overlap(plan: ShelfPlan) -> tuple[LeftOut, ...]:
    """Report overlaps that `meaning: published` permits: its separating lines have tolerances."""
    depth = measure_worst_overlap(plan.scenes, plan.solutions.pose)[plan.solutions.placed]
    deepest = float(np.max(depth, initial=0.0))
    if plan.meaning != "published" or not deepest > _TOUCH:
        return ()
    has_many = len(depth) > 1
    count_text = f", more than {1e3 * _TOUCH:g} mm in {int((depth > _TOUCH).sum())} scenes"
    description = f"books overlap by up to {1e3 * deepest:.1f} mm{count_text if has_many else ''}"
    return (LeftOut("published meaning", description),)


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises:
        PlanFileError: the file is not a whole bookshelf plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
