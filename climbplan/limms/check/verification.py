"""Verification of a LIMMS plan from its file alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.limms.check.checker import check_plan
from climbplan.limms.check.masses import MASSLESS
from climbplan.limms.plan.file import read_unchecked_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.schema.holding import HeldSpec
from climbplan.verification.check import LeftOut
from climbplan.verification.held import describe_reference
from climbplan.verification.verification import Verification, mark_verified


def verify(path: Path, other_spec: HeldSpec | None = None) -> Verification:
    """Verify all claims of the plan in a file.

    Args:
        path: The plan file.
        other_spec: A spec to compare the plan with, in place of its own.

    Raises:
        PlanFileError: The file is not a complete LIMMS plan.
    """
    return verify_plan(read_unchecked_plan(path), other_spec)


def verify_plan(plan: LimmsPlan, other_spec: HeldSpec | None = None) -> Verification:
    """Verify a plan that was read already."""
    # Invalid numbers become infinite or NaN and fail their check without a warning
    with np.errstate(all="ignore"):
        checks = tuple(check_plan(plan, other_spec))
        verification = Verification(checks, against=describe_reference(plan, other_spec))
        return (
            verification
            if verification.unsound
            else replace(verification, beyond=describe_missing_masses(plan))
        )


def describe_missing_masses(plan: LimmsPlan) -> tuple[LeftOut, ...]:
    """Return what checks of a plan without masses do not cover: the weight of modules."""
    if not plan.massless:
        return ()
    weight, capacity = plan.module["mass"] * GRAVITY, plan.module["max_force"]
    text = (
        f"modules have no mass: one weighs {weight:.1f} N, {weight / capacity:.1f} times the "
        f"{capacity:g} N that a contact is said to hold"
    )
    return (LeftOut(MASSLESS, text),)


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises:
        PlanFileError: The file is not a complete LIMMS plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
