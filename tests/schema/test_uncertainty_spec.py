"""What specs and robot files say of uncertainty, and mistakes in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.schema.robots.uncertainty import SpreadSpec

SPEC = Path(__file__).parents[2] / "specs" / "climb_steps.yaml"


def test_numbers_and_distributions() -> None:
    given = ["uncertainty.mass=0.02", "uncertainty.friction={uniform: [-0.3, 0.1]}"]
    spec = load_climb(SPEC, given).spec.uncertainty
    assert spec.mass == 0.02
    assert spec.friction == SpreadSpec(uniform=(-0.3, 0.1))
    assert spec.surface_mm == 3.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("mass=much", "uncertainty.mass: expected a number or a mapping"),
        ("mass=-1", "uncertainty.mass: expected a number or a mapping"),
        ("mass=2", "uncertainty.mass: expected a share below 1"),
        ("friction={uniform: [0.1, -0.1]}", "the lower end first"),
        ("friction={normal: 0.1, uniform: [0, 1]}", "expected one of `normal`"),
        ("friction={normla: 0.1}", "did you mean 'normal'"),
        ("backlash=1", "did you mean 'backlash_deg'"),
    ],
)
def test_mistakes_are_told_with_their_key(given: str, message: str) -> None:
    with pytest.raises(SpecError) as caught:
        load_climb(SPEC, [f"uncertainty.{given}"])
    assert message in str(caught.value)
