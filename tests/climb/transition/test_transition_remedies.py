"""Refused transitions: the changes that a refusal names lead to a plan."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.climb.schema.transition_loading import LoadedTransition, load_transition
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import Remedy, Unresolved
from climbplan.schema.overrides import Override

SPECS = Path(__file__).parents[3] / "specs"


def _refused(loaded: LoadedTransition) -> Unresolved:
    with pytest.raises(Unresolved) as caught:
        plan_transition(loaded)
    return caught.value


def _changed(loaded: LoadedTransition, remedy: Remedy) -> LoadedTransition:
    return loaded.with_overrides([Override(remedy.key, remedy.yaml, remedy.option)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "overrides", "key"),
    [
        ("transition_flat", ("task.rounds=1",), "task.rounds"),
        pytest.param(
            "transition_bricks", ("terrain.boxes=[]",), "task.step_max", marks=pytest.mark.slow
        ),
        (
            "transition_bricks_4",
            ("task.rounds=3", "task.sequence=LF LR RM | RF RR LM | LF LR RM"),
            "task.sequence",
        ),
        pytest.param(
            "mission_ground_to_top", ("climb.rounds=3",), "climb.rounds", marks=pytest.mark.slow
        ),
    ],
)
def test_changes_that_are_named_lead_to_a_plan(
    spec: str, overrides: tuple[str, ...], key: str
) -> None:
    loaded = load_transition(SPECS / f"{spec}.yaml", overrides)
    refused = _refused(loaded)
    assert key in [remedy.key for remedy in refused.remedies]
    for remedy in refused.remedies:
        assert remedy.option in str(refused)
        assert plan_transition(_changed(loaded, remedy)).status == "feasible"


@pytest.mark.slow
def test_more_friction_where_the_walls_are_too_smooth() -> None:
    loaded = load_transition(
        SPECS / "transition_flat.yaml", ["terrain.friction=0.3", "task.sequence=3-3"]
    )
    refused = _refused(loaded)
    found = {remedy.key: remedy.value for remedy in refused.remedies}
    assert isinstance(found["terrain.friction"], float)
    assert 0.3 < found["terrain.friction"] < 0.6
    assert "search.between=any" not in str(refused)  # was tried and did not help


def test_one_method_alone_names_what_failed_there_and_plans_with_nothing() -> None:
    refused = _refused(
        load_transition(
            SPECS / "transition_flat.yaml", ["task.rounds=1", "solver.method=stance-search"]
        )
    )
    assert not refused.remedies
    assert "more rounds" not in str(refused)
