"""Verification of a climb plan from its file alone.

`verify` recomputes every statement a plan makes about itself from the stored arrays, without the
planner's kinematics, mechanics or solvers. What each check says and lets pass is in
`verification.check.LIMITS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.climb.check.clearance import clearance_checks
from climbplan.climb.check.feet import feet_check
from climbplan.climb.check.file import (
    finite_check,
    limits_check,
    robot_check,
    spec_hash_check,
    terrain_check,
)
from climbplan.climb.check.forces import force_checks
from climbplan.climb.check.grips import gripper_check
from climbplan.climb.check.plausibility import implausible_climb
from climbplan.climb.check.postures import posture_checks
from climbplan.climb.check.self_collision import self_collision_check
from climbplan.climb.check.spec import answering, margins_of, risk_of, spec_checks
from climbplan.climb.check.statics import static_checks
from climbplan.climb.check.subject import subject_of
from climbplan.climb.check.trajectory import trajectory_checks
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_as_found
from climbplan.climb.plan.promise import interval_of
from climbplan.climb.plan.world_sample import MIN_STANDING, wilson_interval
from climbplan.schema.holding import HeldSpec
from climbplan.store.content import compute_digest
from climbplan.verification.check import Check, judge, unjudged
from climbplan.verification.held import held_against, held_check
from climbplan.verification.verification import Verification, mark_verified


def risk_check(plan: ClimbPlan) -> Iterator[Check]:
    """The told interval against the counts, the told risk against the spec's.

    This is what the file alone tells of falls: `climbplan simulate` plays the worlds again with the
    engine, seed and number that it names, `climbplan verify --worlds` those of a sample. A promise
    that is not met, or a sample with too many falls, fails nothing: the plan is fragile for it.
    """
    asked, promise = risk_of(plan), plan.promise
    if asked is None and promise is None:
        return
    if promise is None:
        none = judge("robust.risk", 0.0, margin="not judged in any world")
        words = f"the spec asks for falls in at most {asked:.2%} of worlds; none were played"
        yield replace(unjudged(none, "no promise in the file"), fragile=words)
        return
    low, high = interval_of(promise.falls, promise.worlds)
    off = max(abs(promise.lower - low), abs(promise.upper - high))
    off = max(off, abs(promise.risk - asked) if asked is not None else 0.0)
    told = f"{promise.words} ({promise.engine}, seed {promise.seed}), {low:.2%} to {high:.2%} fall"
    check = judge("robust.risk", off, margin=told)
    if check.passed and high > promise.risk:
        first = f"; first of all {promise.fells[0]}" if promise.fells else ""
        words = f"{told}, asked at most {promise.risk:.2%}{first}"
        helps = f"; what would help: {'; '.join(promise.helps)}" if promise.helps else ""
        check = replace(unjudged(check, "a promise that is not met"), fragile=words + helps)
    yield check


def world_sample_check(plan: ClimbPlan) -> Iterator[Check]:
    """The stored interval against the counts of worlds; too many falls make a plan fragile."""
    sample = plan.sample
    if sample is None:
        return
    low, high = wilson_interval(sample.worlds - sample.falls, sample.worlds)
    off = max(abs(sample.lower - low), abs(sample.upper - high))
    words = f"{sample.stands} of its uncertainty ({sample.engine}, seed {sample.seed})"
    check = judge("robust.worlds", off, margin=f"{words}, {sample.interval}")
    if check.passed and not sample.enough:
        first = f"; most frequent: {sample.causes[0]}" if sample.causes else ""
        required = f"at least {MIN_STANDING:.0%} required"
        fragile = f"{words}, {sample.interval}, {required}{first}"
        check = replace(unjudged(check, "worlds that fall fail no check"), fragile=fragile)
    yield check


def verify(path: Path, held: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file; held: against another spec than its own.

    If text, numbers, robot or terrain are unsound, only those checks are made: nothing else
    would mean anything. Raises PlanFileError for a file that is not a whole climb plan.
    """
    return verification_of(read_as_found(path), held)


def verification_of(plan: ClimbPlan, held: HeldSpec | None = None) -> Verification:
    """As `verify`, for a plan that was read already.

    A planner verifies what it is about to return, and then its file is verified. If the file holds
    bit for bit what this process verified last, the outcome is the same and is not computed again.
    """
    if held is not None:
        return _verification_of(plan, held)
    global _last
    try:
        content = _content(plan)
    except TypeError:  # it holds something without a digest
        return _verification_of(plan, None)
    last = _last  # read once: another thread may replace it
    if last is None or last[0] != content:
        last = _last = (content, _verification_of(plan, None))
    return last[1]


_last: tuple[bytes, Verification] | None = None  # digest and outcome of the last plan


def _content(plan: ClimbPlan) -> bytes:
    """Digest of a plan without its creation time, version and what no check reads."""
    forces = replace(plan.forces, margin_share=None)
    return compute_digest(replace(plan, created="", climbplan_version="", forces=forces))


def _verification_of(plan: ClimbPlan, held: HeldSpec | None) -> Verification:
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        checks = tuple(_checks(plan, held))
        stands = "" if plan.promise is None else plan.promise.words
        if not stands and plan.sample is not None:
            stands = plan.sample.stands
        found = Verification(checks, against=held_against(plan, held), stands=stands)
        return found if found.unsound else replace(found, implausible=implausible_climb(plan))


def _checks(plan: ClimbPlan, held: HeldSpec | None) -> Iterator[Check]:
    yield spec_hash_check(plan)
    finite = finite_check(plan.not_finite)
    yield finite
    if not finite.passed:
        return
    sound = (
        robot_check(plan.robot),
        terrain_check(plan.terrain, plan.robot),
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
    yield from static_checks(subject, margins_of(plan))
    yield from risk_check(plan)
    yield from world_sample_check(plan)
    yield from clearance_checks(subject)
    yield self_collision_check(subject)
    yield from feet_check(subject)
    if plan.terrain.scan is not None:
        from climbplan.climb.check.scan import scan_checks

        yield from scan_checks(subject, plan.terrain.scan)
    yield from trajectory_checks(subject)


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises PlanFileError for a file that is not a whole climb plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
