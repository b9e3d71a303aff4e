"""Verification of a climb plan from its file alone.

`verify` recomputes every statement a plan makes about itself from the stored arrays, without the
planner's kinematics, mechanics or solvers. What each check says and lets pass is in
`checks.check.LIMITS`.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from climbplan.errors import UnsoundPlan
from climbplan.plans.atomic_file import written_aside
from climbplan.plans.checks.check import Check
from climbplan.plans.checks.clearance_checks import clearance_checks
from climbplan.plans.checks.file_checks import (
    finite_check,
    limits_check,
    robot_check,
    spec_hash_check,
    terrain_check,
)
from climbplan.plans.checks.force_checks import force_checks
from climbplan.plans.checks.grip_checks import gripper_check
from climbplan.plans.checks.posture_checks import posture_checks
from climbplan.plans.checks.spec_checks import spec_checks
from climbplan.plans.checks.static_checks import static_checks
from climbplan.plans.checks.subject import subject_of
from climbplan.plans.checks.trajectory_checks import trajectory_checks
from climbplan.plans.climb_file import Reading, read_as_found

# Where one of these fails the others are not made: numbers that no robot and no task can have
SOUNDNESS = (
    "file.finite",
    "file.data",
    "robot.data",
    "terrain.data",
    "limits.data",
    "grip.data",
    "scenes.data",
)


@dataclass(frozen=True)
class Verification:
    """All checks of one plan, in the order in which they were made."""

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def unsound(self) -> Check | None:
        """The first failed check of those without which a plan means nothing."""
        return next((check for check in self.failed if check.name in SOUNDNESS), None)

    def require_sound(self, path: Path) -> None:
        """Raise UnsoundPlan for a plan of which nothing can be computed, drawn or passed on."""
        if (worst := self.unsound) is not None:
            where = f" ({worst.worst_at})" if worst.worst_at else ""
            raise UnsoundPlan(
                f"{path}: fails its verification, {worst.name}{where}: nothing else can be made "
                "of it; `climbplan verify` lists every check"
            )

    @property
    def tightest(self) -> Check:
        """The failed check that is furthest off, else the bound of which most is used up."""
        if self.failed:
            return max(self.failed, key=lambda check: check.severity)
        return max(self.checks, key=lambda check: check.used)

    def headline(self) -> str:
        """One line: "31 checks, worst margin: force.friction, round 5, push 2, RF (S_mu 1.8)"."""
        worst = self.tightest
        detail = f" ({worst.margin})" if worst.margin else ""
        place = f", {worst.worst_at}" if worst.worst_at else ""
        if self.failed:
            first = f"{len(self.failed)} of {len(self.checks)} checks failed, worst"
        else:
            first = f"{len(self.checks)} checks, worst margin"
        return f"{first}: {worst.name}{place}{detail}"

    def table(self) -> str:
        """Aligned text, failed checks first, with margins and where the worst is."""
        ordered = sorted(self.checks, key=lambda check: check.passed)
        head = ("check", "residual", "limit", "unit", "", "margin", "worst at")
        rows = [
            (
                check.name,
                f"{check.residual:.1e}",
                f"{check.limit:.0e}" if check.limit else "0",
                check.unit,
                "ok" if check.passed else "FAILED",
                check.margin,
                check.worst_at,
            )
            for check in ordered
        ]
        widths = [max(len(row[c]) for row in [head, *rows]) for c in range(len(head))]
        numeric = {1, 2}
        lines = [
            "  ".join(
                cell.rjust(width) if column in numeric else cell.ljust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in [head, *rows]
        ]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"passed": self.passed, "checks": [check.as_dict() for check in self.checks]}


def verify(path: Path) -> Verification:
    """Recompute all statements of the plan in a file.

    If text, numbers, robot or terrain are unsound, only those checks are made: nothing else
    would mean anything. Raises PlanFileError for a file that is not a whole climb plan.
    """
    return verification_of(read_as_found(path))


def verification_of(reading: Reading) -> Verification:
    """As `verify`, for a plan that was read already."""
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        return Verification(tuple(_checks(reading)))


def _checks(reading: Reading) -> Iterator[Check]:
    plan = reading.plan
    yield spec_hash_check(plan)
    finite = finite_check(reading.not_finite)
    yield finite
    if not finite.passed:
        return
    sound = (
        robot_check(plan.robot),
        terrain_check(plan.terrain),
        limits_check(plan.limits),
        *([gripper_check(plan)] if plan.robot.gripper is not None else []),
    )
    yield from sound
    if not all(check.passed for check in sound):
        return
    subject = subject_of(plan)
    yield from spec_checks(subject)
    yield from posture_checks(subject)
    yield from force_checks(subject)
    yield from static_checks(subject)
    yield from clearance_checks(subject)
    yield from trajectory_checks(subject)


def mark_verified(path: Path, verification: Verification) -> None:
    """Write the outcome into the file's attribute `verified`; the file changes whole or not."""
    with written_aside(path) as aside:
        shutil.copyfile(path, aside)
        with h5py.File(aside, "r+") as file:
            file.attrs["verified"] = np.bool_(verification.passed)
        os.chmod(aside, path.stat().st_mode)


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises PlanFileError for a file that is not a whole climb plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
