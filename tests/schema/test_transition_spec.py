"""Transition specs: what is refused, and in which words."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.climb.schema.transition_loading import load_transition
from climbplan.errors import SpecError

FLAT = Path(__file__).parents[2] / "specs" / "transition_flat.yaml"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("task.sequence=4-2", "cannot move at once"),
        ("task.sequence=3-3-3", "expected `rounds`: 2"),
        ("task.sequence=3--3", "expected counts of limbs"),
        ("task.sequence=RF RR XX | RM LR LF", "no limb 'XX'"),
        ("task.step_max.XX=0.3", "no limb 'XX'"),
        ("task.min_supporting_limbs=6", "none can move"),
        ("terrain.walls.friction=-1", "expected a number > 0"),
        ("terrain.ground.across=[1, 0]", "from < to"),
    ],
)
def test_mistakes_are_named(override: str, words: str) -> None:
    with pytest.raises(SpecError) as caught:
        load_transition(FLAT, [override])
    message = str(caught.value)
    assert override.split("=")[0] in message
    assert words in message


def test_sequence_counts() -> None:
    task = load_transition(FLAT, ["task.rounds=4", 'task.sequence="3-1-1-1"']).spec.task
    assert task.moving == (3, 1, 1, 1)
    assert load_transition(FLAT).spec.task.moving == ()
