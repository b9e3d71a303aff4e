"""Verification of a walking plan from its file alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.schema.holding import HeldSpec
from climbplan.verification.held import describe_reference
from climbplan.verification.plausibility import (
    warn_of_force,
    warn_of_friction,
    warn_of_gravity,
)
from climbplan.verification.verification import Verification, mark_verified
from climbplan.walking.check.plan_checks import check_plan
from climbplan.walking.plan.file import read_unchecked_plan
from climbplan.walking.plan.walk_plan import WalkPlan

MAX_OMEGA = 20.0  # [rad/s] three turns a second of the body


def find_implausible(plan: WalkPlan) -> tuple[str, ...]:
    """Return warnings about gravity, friction, forces and angular velocities of a walk."""
    return tuple(_generate_warnings(plan))


def _generate_warnings(plan: WalkPlan) -> Iterator[str]:
    """Yield the warnings."""
    task, trajectory = plan.task, plan.trajectory
    yield from warn_of_gravity(task.body.gravity)
    yield from warn_of_friction("the ground", task.ground.friction)
    size = np.linalg.norm(trajectory.force, axis=-1)
    n, leg = (int(i) for i in np.unravel_index(int(np.argmax(size)), size.shape))
    where = f" ({task.body.leg_names[leg]}, {task.dt * n:.2f} s)"
    weight = task.body.mass * task.body.gravity
    yield from warn_of_force(float(size[n, leg]), weight, where)
    spin = float(np.abs(trajectory.state[:, 9:]).max())
    if spin > MAX_OMEGA:
        yield f"the body turns at {spin:.0f} rad/s"


def verify(path: Path, other_spec: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file.

    Args:
        path: The plan file.
        other_spec: A spec that the plan has to satisfy instead of its own.

    Raises:
        PlanFileError: the file is not a whole walking plan.
    """
    plan = read_unchecked_plan(path)
    # Absurd numbers become infinite or NaN, and fail their check without a warning.
    with np.errstate(all="ignore"):
        checks = tuple(check_plan(plan, other_spec))
        verification = Verification(checks, against=describe_reference(plan, other_spec))
        return (
            verification
            if verification.unsound
            else replace(verification, implausible=find_implausible(plan))
        )


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it."""
    verification = verify(path)
    mark_verified(path, verification)
    return verification
