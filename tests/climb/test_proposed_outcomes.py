"""What `new robot` says of plans that keep none of their margins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from climbplan.api.new_robot import _describe_for_page
from climbplan.climb.plan.world_sample import WorldSample, compute_wilson_interval
from climbplan.climb.proposed import proposed
from climbplan.climb.proposed.outcome import SpecOutcome
from climbplan.climb.proposed.proposed import ProposalTrials


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (None, "climbs: verified"),
        ([1.0, 0.05], "climbs: verified"),
        # A motor at its limit is no spring
        ([1.0, 0.0], "climbs: verified, but may fall: 0% of its margins (torque of RF knee)"),
        ([0.9, -0.4], "climbs: verified, but may fall: -40% of its margins (torque of RF knee)"),
    ],
)
def test_plans_that_keep_none_of_their_margins_may_fall(
    kept: list[float] | None, words: str
) -> None:
    share = None if kept is None else np.array(kept)
    forces = SimpleNamespace(margin_share=share, notes=("torque of RF knee",))
    plan: Any = SimpleNamespace(forces=forces)
    assert str(SpecOutcome("climbs", plan, "")) == words


def outcome(share: float, falls: int | None, **other: Any) -> SpecOutcome:
    plan: Any = SimpleNamespace(forces=SimpleNamespace(margin_share=np.array([share]), notes=()))
    sample = None
    if falls is not None:
        lower, upper = compute_wilson_interval(100 - falls, 100)
        sample = WorldSample("statics", 0, 100, falls, lower, upper, {}, ("30: a toe slides",))
    return SpecOutcome("climbs", plan, "", sample=sample, **other)


def test_worlds_decide_where_they_were_played() -> None:
    firm, keeping = outcome(0.4, 1), outcome(1.0, 37)
    assert firm.rank > keeping.rank
    assert firm.is_good_enough(0.9)
    assert not keeping.is_good_enough(0.9)
    assert outcome(1.0, None).is_good_enough(0.9)
    assert not outcome(0.8, None).is_good_enough(0.9)
    refused = SpecOutcome("climbs", None, "no posture")
    assert keeping.rank > refused.rank
    assert not refused.is_good_enough(0.0)


def test_a_plan_that_must_not_be_used_is_the_last_that_is_taken() -> None:
    odd = outcome(1.0, 0, implausible=("the body sags by 20 degrees",))
    assert not odd.is_good_enough(0.9)
    assert outcome(0.1, 90).rank > odd.rank
    assert str(odd) == "climbs: do not use: implausible: the body sags by 20 degrees"


def test_what_is_said_of_worlds() -> None:
    words = "of 100 worlds of its uncertainty (95 % interval"
    assert str(outcome(1.0, 2)) == f"climbs: verified, stands in 98 {words} 93 to 99 %)"
    falls = str(outcome(1.0, 37, needed="uncertainty.friction=0.1 (stands in 96 then)"))
    assert falls == (
        f"climbs: verified, but stands in 63 {words} 53 to 72 %); most frequent: 30: a toe slides"
        "; needed: uncertainty.friction=0.1 (stands in 96 then)"
    )


def test_only_plans_that_would_be_written_are_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    verified: list[float] = []

    def verify(tried: SpecOutcome) -> SpecOutcome:
        verified.append(tried.standing)
        return replace(tried, plan=None, sample=None) if tried.standing == 0.9 else tried

    monkeypatch.setattr(proposed, "_verify_outcome", verify)
    trials = object.__new__(ProposalTrials)
    found = iter([outcome(0.9, 40), outcome(0.9, 10), outcome(0.9, 20), outcome(0.9, 0)])
    best, tried = trials._select_best("climbs", found, 3, (0.9, 0.95))
    assert (best.standing, len(tried), verified) == (0.8, 3, [0.9, 0.8])
    # The search ends at a plan that is good enough, and where plans get hardly better
    for falls, count in (((60, 2, 0), 2), ((40, 38, 0), 2), ((40, 30, 0), 3)):
        planned = (outcome(0.9, number) for number in falls)
        assert len(trials._select_best("climbs", planned, 3, (0.9, 0.95))[1]) == count


def test_postures_without_plans_end_the_search() -> None:
    trials = object.__new__(ProposalTrials)
    refused = (SpecOutcome("climbs", None, f"posture {number}") for number in range(9))
    best, tried = trials._select_best("climbs", refused, 3, (0.9, 0.95))
    assert (best.why, len(tried)) == ("posture 0", 3)


@pytest.mark.parametrize(
    ("falls", "num_planned", "chosen"),
    [
        ([3], 1, 0),  # it stands in enough worlds
        ([None], 1, 0),  # none were sampled
        ([84, 40, 2], 3, 2),
        ([84, 90, 95], 3, 0),
    ],
)
def test_another_standing_posture_is_taken_where_the_first_falls(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    falls: list[int | None],
    num_planned: int,
    chosen: int,
) -> None:
    postures: list[Any] = [SimpleNamespace(name="robot", place=k) for k in range(3)]
    planned: list[Any] = []

    def plan_walk(trials: ProposalTrials) -> SpecOutcome:
        planned.append(trials.proposal)
        return outcome(0.4, falls[trials.proposal.place])

    def write_robot(trials: ProposalTrials, proposal: Any) -> None:
        trials.proposal = proposal

    monkeypatch.setattr(ProposalTrials, "_plan_walk", plan_walk)
    monkeypatch.setattr(ProposalTrials, "_write_robot", write_robot)
    monkeypatch.setattr(ProposalTrials, "list_alternatives", lambda trials: postures[1:])
    trials = ProposalTrials(postures[0], tmp_path)
    assert planned == postures[:num_planned]
    assert trials.proposal is postures[chosen]
    assert trials.ground.sample == outcome(0.4, falls[chosen]).sample


def test_the_page_of_a_robot_marks_each_task_by_its_outcome() -> None:
    none = SpecOutcome("climbs", None, "no posture")
    odd = outcome(1.0, 0, implausible=("the body sags by 20 degrees",))
    tasks = [_describe_for_page(one) for one in (outcome(0.4, 1), outcome(0.4, 60), odd, none)]
    assert [task.colour for task in tasks] == ["good", "part", "part", "bad"]
    assert [task.badge for task in tasks] == ["climbs", "climbs", "climbs", "not found: climbs"]
    assert tasks[1].sentence == str(outcome(0.4, 60))
