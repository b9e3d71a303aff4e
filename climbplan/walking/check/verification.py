"""Verification of an MPC plan from its file alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.schema.holding import HeldSpec
from climbplan.verification.held import held_against
from climbplan.verification.plausibility import (
    implausible_force,
    implausible_friction,
    implausible_gravity,
)
from climbplan.verification.verification import Verification, mark_verified
from climbplan.walking.check.plan_checks import plan_checks
from climbplan.walking.plan.file import read_as_found
from climbplan.walking.plan.walk_plan import WalkPlan

SPIN = 20.0  # [rad/s] three turns a second of the body


def implausible_walk(plan: WalkPlan) -> tuple[str, ...]:
    """Warnings about robot, ground and forces of a walk."""
    return tuple(_warnings(plan))


def _warnings(plan: WalkPlan) -> Iterator[str]:
    task, found = plan.task, plan.trajectory
    yield from implausible_gravity(task.body.gravity)
    yield from implausible_friction("the ground", task.ground.friction)
    size = np.linalg.norm(found.force, axis=-1)
    n, leg = (int(i) for i in np.unravel_index(int(np.argmax(size)), size.shape))
    where = f" ({task.body.leg_names[leg]}, {task.step * n:.2f} s)"
    weight = task.body.mass * task.body.gravity
    yield from implausible_force(float(size[n, leg]), weight, where)
    spin = float(np.abs(found.state[:, 9:]).max())
    if spin > SPIN:
        yield f"the body turns at {spin:.0f} rad/s"


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
