"""What a plan says of falls, as far as its file alone tells: counts, interval and the bound.

The worlds themselves are played again by `climbplan simulate` with the engine, seed and number that
the file names, and those of a sample by `climbplan verify --worlds`. A promise that is not met, or
a sample with too many falls, fails nothing: the plan is fragile for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from climbplan.climb.check.spec import risk_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import interval_of
from climbplan.climb.plan.world_sample import MIN_STANDING, wilson_interval
from climbplan.verification.check import Check, judge, unjudged


def risk_check(plan: ClimbPlan) -> Iterator[Check]:
    """The told interval against the counts, the told risk against the spec's."""
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
