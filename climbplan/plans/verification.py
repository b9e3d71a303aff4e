"""Verification of a climb plan from its file alone.

`verify` recomputes every statement a plan makes about itself from the stored arrays, without the
planner's kinematics, mechanics or solvers. What each check says and lets pass is in
`checks.check.LIMITS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.errors import UnsoundPlan
from climbplan.plans.checks.check import Check, LeftOut
from climbplan.plans.checks.check_table import check_table
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
from climbplan.plans.checks.spec_checks import answering, spec_checks
from climbplan.plans.checks.static_checks import static_checks
from climbplan.plans.checks.subject import subject_of
from climbplan.plans.checks.trajectory_checks import trajectory_checks
from climbplan.plans.climb_file import Reading, read_as_found
from climbplan.plans.hdf5_writing import amended_store, write_json, write_text
from climbplan.plans.held import Against, held_against, held_check
from climbplan.plans.plausibility import implausible_climb
from climbplan.spec.holding import HeldSpec

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
    """All checks of one plan, in the order in which they were made, and what they are worth."""

    checks: tuple[Check, ...]
    beyond: tuple[LeftOut, ...] = ()  # what the world asks of such a plan and no check looks at
    implausible: tuple[str, ...] = ()  # data and deflections that no such robot has, in words
    against: Against | None = None  # the spec that the plan was held against

    @property
    def passed(self) -> bool:
        """Whether every check passed that is judged."""
        return all(check.passed for check in self.checks)

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """What the plan needs in the world and no check of it holds."""
        own = (check.left_out for check in self.checks)
        return tuple(dict.fromkeys([*self.beyond, *(out for out in own if out is not None)]))

    @property
    def badge(self) -> str:
        """What can be said of the plan: "verified", "verified in its model (...)", or not."""
        if not self.passed:
            return "not verified"
        if not self.model:
            return "verified"
        return f"verified in its model ({self.model})"

    @property
    def model(self) -> str:
        """What the plan is verified in, "" where nothing is left out: "forward Euler"."""
        data = ["implausible data"] if self.implausible else []
        return ", ".join(dict.fromkeys([*data, *(out.model for out in self.left_out)]))

    @property
    def leaves_out(self) -> tuple[str, ...]:
        """What that leaves out, in short phrases with figures; `implausible` stands beside it."""
        return tuple(dict.fromkeys(out.words for out in self.left_out))

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
        told = sum(not check.judged for check in self.checks)
        count = f"{len(self.checks)} checks" + (f", {told} not judged" if told else "")
        if self.failed:
            first = f"{len(self.failed)} of {len(self.checks)} checks failed, worst"
        else:
            first = f"{count}, worst margin"
        return f"{first}: {worst.name}{place}{detail}"

    def table(self) -> str:
        """Aligned text, failed checks first, with margins and where the worst is."""
        return check_table(self.checks)

    def scope(self) -> dict[str, Any]:
        """What the badge says, as plain values for JSON: of reports and of `as_dict`."""
        return {
            "badge": self.badge,
            "verified_in": self.model,
            "leaves_out": list(self.leaves_out),
            "implausible": list(self.implausible),
            "verified_against": self.against.as_dict() if self.against is not None else None,
        }

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        checks = [check.as_dict() for check in self.checks]
        return {"passed": self.passed, "checks": checks, **self.scope()}


def verify(path: Path, held: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file; held: against another spec than its own.

    If text, numbers, robot or terrain are unsound, only those checks are made: nothing else
    would mean anything. Raises PlanFileError for a file that is not a whole climb plan.
    """
    return verification_of(read_as_found(path), held)


def verification_of(reading: Reading, held: HeldSpec | None = None) -> Verification:
    """As `verify`, for a plan that was read already."""
    plan = reading.plan
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        checks = tuple(_checks(reading, held))
        found = Verification(checks, against=held_against(plan, held))
        return found if found.unsound else replace(found, implausible=implausible_climb(plan))


def _checks(reading: Reading, held: HeldSpec | None) -> Iterator[Check]:
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
    if held is not None:
        yield held_check(held)
        plan = answering(plan, held)
    subject = subject_of(plan)
    yield from spec_checks(subject, None if held is None else held.robot)
    yield from posture_checks(subject)
    yield from force_checks(subject)
    yield from static_checks(subject)
    yield from clearance_checks(subject)
    yield from trajectory_checks(subject)


def mark_verified(path: Path, verification: Verification) -> None:
    """Write the outcome into the file's attributes; the file changes whole or not at all.

    `verified`, and what it is worth: `badge`, `verified_in`, `leaves_out` (JSON).
    """
    with amended_store(path) as file:
        file.attrs["verified"] = np.bool_(verification.passed)
        write_text(file, "badge", verification.badge)
        write_text(file, "verified_in", verification.model)
        write_json(file, "leaves_out", list(verification.leaves_out))


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises PlanFileError for a file that is not a whole climb plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
