"""`new robot` asks for larger margins where all are kept and too many worlds fall."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from climbplan.climb.plan.world_sample import WorldSample
from climbplan.climb.proposed.outcome import SpecOutcome
from climbplan.climb.proposed.proposed import ProposalTrials

TEXT = "kind: climb\nforce: {safety_friction: 1.2}\nseed: 0\n"


def outcome(text: str, falls: int, share: float = 1.0) -> SpecOutcome:
    plan: Any = SimpleNamespace(forces=SimpleNamespace(margin_share=np.array([share]), notes=()))
    sample = WorldSample("statics", 0, 100, falls, 0.0, 1.0, {})
    return SpecOutcome("climbs", plan, "", text, sample=sample)


@pytest.mark.parametrize(
    ("share", "falls", "tried", "last"),
    [
        (1.0, [9, 7, 1], 2, 1),
        (1.0, [6, 2, 0], 1, 2),  # it stands in enough worlds
        (1.0, [6, 9, 7], 2, 6),  # none falls in fewer
        (0.5, [6, 0, 0], 0, 6),  # motors have nothing left
        (1.0, [1, 0, 0], 0, 1),
    ],
)
def test_margins_grow_as_long_as_they_are_kept(
    share: float, falls: list[int], tried: int, last: int
) -> None:
    texts: list[str] = []

    def plan(what: str, text: str, brace: object) -> SpecOutcome:
        texts.append(text)
        return outcome(text, falls[len(texts)])

    trials = ProposalTrials.__new__(ProposalTrials)
    trials._plan_spec = plan  # type: ignore[method-assign, assignment]
    found = trials._try_larger_margins(outcome(TEXT, falls[0], share), lambda words: None)
    assert len(texts) == tried
    assert found.sample is not None
    assert found.sample.falls == last
    assert all("\nmargins: {slip: 0." in text for text in texts)
    assert all(text.endswith("\nseed: 0\n") for text in texts)
