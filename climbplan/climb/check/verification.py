"""Verification of a climb plan from its file alone.

`verify` recomputes every statement of a plan about itself from the stored arrays, without the
planner's kinematics, mechanics or solvers. The meaning and the tolerance of each check are in
`verification.check.LIMITS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.climb.check.clearance import check_clearance
from climbplan.climb.check.feet import check_feet
from climbplan.climb.check.file import (
    check_finite,
    check_limits,
    check_robot,
    check_spec_hash,
    check_terrain,
)
from climbplan.climb.check.forces import check_forces
from climbplan.climb.check.grips import check_gripper_data
from climbplan.climb.check.plausibility import find_implausible_values
from climbplan.climb.check.postures import check_postures
from climbplan.climb.check.self_collision import check_self_collision
from climbplan.climb.check.spec import (
    bind_to_spec,
    check_spec,
    counts_in_closed_loop,
    read_margins,
    read_risk_limit,
)
from climbplan.climb.check.statics import check_statics
from climbplan.climb.check.subject import build_subject
from climbplan.climb.check.trajectory import check_trajectory
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_as_found
from climbplan.climb.plan.promise import compute_interval
from climbplan.climb.plan.world_sample import MIN_STANDING, compute_wilson_interval
from climbplan.schema.holding import HeldSpec
from climbplan.store.content import compute_digest
from climbplan.verification.check import Check, judge, mark_unjudged
from climbplan.verification.held import check_spec_differences, describe_reference
from climbplan.verification.verification import Verification, mark_verified


def check_risk(plan: ClimbPlan) -> Iterator[Check]:
    """Check the stored interval against the counts, and risk and execution against the spec's.

    The file alone gives no more information on falls. `climbplan simulate` repeats the worlds with
    the stored engine, seed and number, `climbplan verify --worlds` those of a sample. A missed
    promise, or a sample with too many falls, fails no check: the plan is then fragile.
    """
    risk_limit, promise = read_risk_limit(plan), plan.promise
    if risk_limit is None and promise is None:
        return
    if promise is None:
        unsampled = judge("robust.risk", 0.0, margin="not judged in any world")
        fragility_text = (
            f"the spec asks for falls in at most {risk_limit:.2%} of worlds; none were played"
        )
        yield replace(mark_unjudged(unsampled, "no promise in the file"), fragile=fragility_text)
        return
    low, high = compute_interval(promise.falls, promise.worlds)
    interval_error = max(abs(promise.lower - low), abs(promise.upper - high))
    interval_error = max(
        interval_error, abs(promise.risk - risk_limit) if risk_limit is not None else 0.0
    )
    promise_text = (
        f"{promise.words} ({promise.engine}, seed {promise.seed}), {low:.2%} to {high:.2%} fall"
    )
    if risk_limit is not None and promise.closed_loop != counts_in_closed_loop(plan):
        interval_error = np.inf
        loop, stated_loop = ("closed", "open") if promise.closed_loop else ("open", "closed")
        promise_text += f", counted in {loop} loop where the spec asks for {stated_loop} loop"
    check = judge("robust.risk", interval_error, margin=promise_text)
    if check.passed and high > promise.risk:
        first_cause = f"; first of all {promise.fells[0]}" if promise.fells else ""
        fragility_text = f"{promise_text}, asked at most {promise.risk:.2%}{first_cause}"
        remedy_text = f"; what would help: {'; '.join(promise.helps)}" if promise.helps else ""
        check = replace(
            mark_unjudged(check, "a promise that is not met"), fragile=fragility_text + remedy_text
        )
    yield check


def check_world_sample(plan: ClimbPlan) -> Iterator[Check]:
    """Check the stored interval against the counts; too many falls make a plan fragile."""
    sample = plan.sample
    if sample is None:
        return
    low, high = compute_wilson_interval(sample.worlds - sample.falls, sample.worlds)
    interval_error = max(abs(sample.lower - low), abs(sample.upper - high))
    sample_text = f"{sample.stands} of its uncertainty ({sample.engine}, seed {sample.seed})"
    check = judge("robust.worlds", interval_error, margin=f"{sample_text}, {sample.interval}")
    if check.passed and not sample.enough:
        first_cause = f"; most frequent: {sample.causes[0]}" if sample.causes else ""
        requirement = f"at least {MIN_STANDING:.0%} required"
        fragile = f"{sample_text}, {sample.interval}, {requirement}{first_cause}"
        check = replace(mark_unjudged(check, "worlds that fall fail no check"), fragile=fragile)
    yield check


def verify(path: Path, other_spec: HeldSpec | None = None) -> Verification:
    """Recompute all statements of the plan in a file.

    If text, numbers, robot or terrain are unsound, only those checks are made, because no other
    would mean anything.

    Args:
        path: The plan file.
        other_spec: Another spec to verify against; None for the plan's own.

    Raises:
        PlanFileError: The file is not a complete climb plan.
    """
    return verify_plan(read_as_found(path), other_spec)


def verify_plan(plan: ClimbPlan, other_spec: HeldSpec | None = None) -> Verification:
    """Recompute all statements of a plan that was read already, as `verify` does.

    A planner verifies what it returns, and its file is verified again, with the worlds that were
    sampled in between. What is the same bit for bit as in the last verification of this process is
    not recomputed.
    """
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn
    with np.errstate(all="ignore"):
        if other_spec is None:
            checks = _recompute_unless_known(plan)
        else:
            checks = tuple(_generate_checks(plan, other_spec))
        if not Verification(checks).unsound:
            checks = (*checks, *check_risk(plan), *check_world_sample(plan))
        risk_summary = "" if plan.promise is None else plan.promise.words
        if not risk_summary and plan.sample is not None:
            risk_summary = plan.sample.stands
        verification = Verification(
            checks, against=describe_reference(plan, other_spec), risk_summary=risk_summary
        )
        return (
            verification
            if verification.unsound
            else replace(verification, implausible=find_implausible_values(plan))
        )


_last: tuple[bytes, tuple[Check, ...]] | None = None  # digest of the last plan, and its checks


def _recompute_unless_known(plan: ClimbPlan) -> tuple[Check, ...]:
    """Return the checks of a plan but those of its risk.

    They are those of the last verification where the plan is the same.
    """
    global _last
    try:
        content = _compute_content_digest(plan)
    except TypeError:  # it holds something without a digest
        return tuple(_generate_checks(plan, None))
    last = _last  # read once: another thread may replace it
    if last is None or last[0] != content:
        last = _last = (content, tuple(_generate_checks(plan, None)))
    return last[1]


def _compute_content_digest(plan: ClimbPlan) -> bytes:
    """Return the digest of a plan without what `_generate_checks` does not read."""
    checked = replace(
        plan,
        created="",
        climbplan_version="",
        timings={},
        warnings=(),
        forces=replace(plan.forces, margin_share=None, notes=()),
        looks=None,
        promise=None,
        sample=None,
    )
    return compute_digest(checked)


def _generate_checks(plan: ClimbPlan, other_spec: HeldSpec | None) -> Iterator[Check]:
    """Yield the checks but those of risk, in order; unsound data end the sequence."""
    yield check_spec_hash(plan)
    finite = check_finite(plan.not_finite)
    yield finite
    if not finite.passed:
        return
    data_checks = (
        check_robot(plan.robot),
        check_terrain(plan.terrain, plan.robot),
        check_limits(plan.limits),
        *([check_gripper_data(plan)] if plan.robot.gripper is not None else []),
    )
    yield from data_checks
    if not all(check.passed for check in data_checks):
        return
    if other_spec is not None:
        yield check_spec_differences(other_spec)
        plan = bind_to_spec(plan, other_spec)
    subject = build_subject(plan)
    yield from check_spec(subject, None if other_spec is None else other_spec.robot)
    yield from check_postures(subject)
    yield from check_forces(subject)
    yield from check_statics(subject, read_margins(plan))
    yield from check_clearance(subject)
    yield check_self_collision(subject)
    yield from check_feet(subject)
    if plan.terrain.scan is not None:
        from climbplan.climb.check.scan import check_scan

        yield from check_scan(subject, plan.terrain.scan)
    yield from check_trajectory(subject)


def verify_and_mark(path: Path) -> Verification:
    """Verify a plan file and write the outcome into it.

    Raises:
        PlanFileError: The file is not a complete climb plan.
    """
    verification = verify(path)
    mark_verified(path, verification)
    return verification
