"""Verification of a LIMMS plan from its file alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.limms.check.checker import plan_checks
from climbplan.limms.check.masses import MASSLESS
from climbplan.limms.plan.file import read_as_found
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.schema.holding import HeldSpec
from climbplan.verification.check import LeftOut
from climbplan.verification.held import held_against
from climbplan.verification.verification import Verification, mark_verified


def verify(path: Path, held: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file; held: against another spec than its own.

    Raises PlanFileError for a file that is not a whole LIMMS plan.
    """
    return verification_of(read_as_found(path), held)


def verification_of(plan: LimmsPlan, held: HeldSpec | None = None) -> Verification:
    """As `verify`, for a plan that was read already."""
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        checks = tuple(plan_checks(plan, held))
        found = Verification(checks, against=held_against(plan, held))
        return found if found.unsound else replace(found, beyond=massless(plan))


def massless(plan: LimmsPlan) -> tuple[LeftOut, ...]:
    """What checks of a plan without masses do not judge: modules weigh something."""
    if not plan.massless:
        return ()
    weight, held = plan.module["mass"] * GRAVITY, plan.module["max_force"]
    words = (
        f"modules have no mass: one weighs {weight:.1f} N, {weight / held:.1f} times the "
        f"{held:g} N that a contact is said to hold"
    )
    return (LeftOut(MASSLESS, words),)


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises PlanFileError for a file that is not a whole LIMMS plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
