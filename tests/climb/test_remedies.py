"""Remedies are stated as what was tried, not as limits that nobody has proved."""

from __future__ import annotations

import pytest

from climbplan.climb.planner.automatic import FailedTrial, NoTrialSucceeded
from climbplan.climb.planner.remedies import describe_as_planned, format_remedies
from climbplan.climb.planner.trials import MethodVariant
from climbplan.errors import Conflict, Remedy, Unresolved

PAYLOAD = Remedy("payload <= 2.33 kg", "task.payload.mass", 2.33)


@pytest.mark.parametrize(
    ("remedy", "words"),
    [
        (PAYLOAD, "planned with payload 2.33 kg"),
        (Remedy("mu >= 0.83", "terrain.friction", 0.83), "planned with mu 0.83"),
        (
            Remedy("payload from 1.2 to 3.4 kg", "task.payload.mass", 3.4),
            "planned with payload 3.4 kg",
        ),
        (Remedy("8 rounds", "task.rounds", 8), "8 rounds"),
    ],
)
def test_a_limit_becomes_what_was_planned_with(remedy: Remedy, words: str) -> None:
    tried = describe_as_planned(remedy)
    assert tried.words == words
    assert tried.option == remedy.option


def test_a_refusal_claims_no_limit() -> None:
    conflict = Conflict("round 1, LF lifted", ("torque of LF", "friction at RR"), (PAYLOAD,))
    error = Unresolved("no forces", [conflict], because="postures were chosen", stage="force")
    tried = FailedTrial(MethodVariant("micp", "micp"), error, 0.1)
    text = str(NoTrialSucceeded([tried], [describe_as_planned(PAYLOAD)], time_ran_out=False))
    assert "what was tried is feasible with payload <= 2.33 kg" in text
    assert "needed" not in text
    assert format_remedies([describe_as_planned(PAYLOAD)])[1] in text
    assert "(planned with payload 2.33 kg)" in text


def test_conflicts_keep_their_changes_where_none_were_sought() -> None:
    conflict = Conflict("round 1, LF lifted", ("torque of LF",), (PAYLOAD,))
    error = Unresolved("no forces", [conflict], because="postures were chosen", stage="force")
    failed = [FailedTrial(MethodVariant("micp", "micp"), error, 0.1)]
    unsought = NoTrialSucceeded(failed, None, time_ran_out=False)
    assert unsought.remedies == (PAYLOAD,)
    assert "what was tried is feasible with payload <= 2.33 kg" in str(unsought.conflicts[0])
    assert not NoTrialSucceeded(failed, [], time_ran_out=False).remedies
