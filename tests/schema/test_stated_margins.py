"""Margins grow with what a spec says to be uncertain, and stay where it says nothing."""

from __future__ import annotations

from typing import Any

import pytest

from climbplan.climb.schema.loading import load_text
from climbplan.climb.schema.margins import NO_MARGINS, MarginsSpec
from climbplan.climb.schema.stated_margins import widen_margins
from climbplan.schema.robots.uncertainty import UncertaintySpec

SPEC = """
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.4]}
task: {rounds: 1, start: {com: [0, 0, 0]}, goal: {com: [0, 0, 0.05]}}
"""


@pytest.mark.parametrize(
    ("uncertain", "changed"),
    [
        ({}, {}),
        ({"friction": 0.05}, {}),  # defaults cover it
        ({"friction": 0.2}, {"slip": 0.4}),  # two standard deviations
        ({"friction": {"uniform": [-0.3, 0.5]}}, {"slip": 0.3}),  # more friction does no harm
        ({"friction": {"uniform": [-0.95, 0.0]}}, {"slip": 0.6}),
        ({"surface_mm": {"uniform": [-3, 3]}}, {}),
        ({"surface_mm": {"normal": 4}}, {"depth": 0.010}),
        ({"joint_stiffness": {"uniform": [-0.1, 0.2]}}, {"friction": 0.16}),
        ({"toe_placement_mm": 4}, {"edge": 0.013}),
    ],
)
def test_margins_cover_what_is_stated(uncertain: dict[str, Any], changed: dict[str, float]) -> None:
    found = widen_margins(MarginsSpec(), UncertaintySpec.model_validate(uncertain))
    asked = MarginsSpec().model_dump(exclude={"rounds"}) | changed
    assert found.model_dump(exclude={"rounds"}) == pytest.approx(asked)


def test_what_a_spec_says_of_margins_stands() -> None:
    slippery = UncertaintySpec(friction=0.2)
    assert widen_margins(MarginsSpec(slip=0.1), slippery).slip == 0.1
    assert widen_margins(NO_MARGINS, slippery) == NO_MARGINS


def test_specs_have_them() -> None:
    assert load_text(SPEC, "short", []).spec.margins == MarginsSpec()
    uncertain = load_text(SPEC, "short", ["uncertainty.friction=0.15"]).spec
    assert uncertain.margins.slip == pytest.approx(0.3)
