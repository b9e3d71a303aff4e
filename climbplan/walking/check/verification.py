"""Verification of an MPC plan from its file alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.schema.holding import HeldSpec
from climbplan.verification.held import held_against
from climbplan.verification.verification import Verification, mark_verified
from climbplan.walking.check.plan_checks import plan_checks
from climbplan.walking.check.plausibility import implausible_walk
from climbplan.walking.plan.file import read_as_found


def verify(path: Path, held: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file; held: against another spec than its own.

    Raises PlanFileError for a file that is not a whole MPC plan.
    """
    plan = read_as_found(path)
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        checks = tuple(plan_checks(plan, held))
        found = Verification(checks, against=held_against(plan, held))
        return found if found.unsound else replace(found, implausible=implausible_walk(plan))


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it."""
    verification = verify(path)
    mark_verified(path, verification)
    return verification
