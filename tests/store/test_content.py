"""Digests of plans: equal for what a file gives back, different for any change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from example_climb import Climb

import climbplan.climb.check.verification as verification
from climbplan.climb.plan.file import read_as_found
from climbplan.climb.plan.world_sample import WorldSample
from climbplan.store.content import compute_digest


def test_a_file_gives_back_what_was_written(original: Path) -> None:
    assert compute_digest(read_as_found(original)) == compute_digest(read_as_found(original))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (np.zeros(2), np.zeros((2, 1))),
        (np.zeros(2), np.array([0.0, -0.0])),
        (np.zeros(2), np.zeros(2, np.float32)),
        (("ab", "c"), ("a", "bc")),
        ({"a": 1}, {"a": 1.0}),
        ((), []),
        (None, "None"),
    ],
)
def test_what_differs_has_another_digest(one: object, other: object) -> None:
    assert compute_digest(one) != compute_digest(other)


def test_what_cannot_be_looked_at_is_refused() -> None:
    for value in (object(), np.array([object()]), {"key": {1, 2}}):
        with pytest.raises(TypeError, match="no digest"):
            compute_digest(value)


def test_a_plan_is_verified_once_and_again_after_any_change(
    climb: Climb, original: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged = []
    check = verification._generate_checks
    monkeypatch.setattr(verification, "_last", None)
    monkeypatch.setattr(
        verification, "_generate_checks", lambda *given: judged.append(given) or check(*given)
    )
    first = verification.verify_plan(climb.plan)
    assert verification.verify(original) == first  # the file holds the same
    # The worlds that are sampled after planning change no check but their own
    sample = WorldSample("statics", 0, 100, 4, 0.9, 0.98, {})
    sampled = verification.verify_plan(replace(climb.plan, sample=sample))
    assert [c for c in sampled.checks if c.name != "robust.worlds"] == [*first.checks]
    assert len(judged) == 1
    climb.plan.trajectory.com[5, 2] += 1e-12  # in place, in memory alone
    try:
        verification.verify_plan(climb.plan)
    finally:
        climb.plan.trajectory.com[5, 2] -= 1e-12
    other = replace(climb.plan, objective=climb.plan.objective + 1e-9)
    verification.verify_plan(other)
    assert len(judged) == 3
