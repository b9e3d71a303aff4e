"""Remedies of the force stage: tried before they are named, and never rounded to what fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.verified_remedies import keep_verified_remedies
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Remedy, Unresolved
from climbplan.instances.straight_climb import interpolate_rounds

SceneMaker = Callable[..., ClimbScene]


@pytest.mark.parametrize(
    "changes",
    [
        {"terrain.friction": 0.5},
        {"force.safety_torque": 4.0},
        {"task.payload.mass": 9.0},
    ],
)
def test_every_remedy_that_is_named_is_enough(
    changes: dict[str, float], demo_climb: SceneMaker
) -> None:
    scene = demo_climb(**changes)
    with pytest.raises(Unresolved) as caught:
        plan_forces(scene, plan_instants(scene, interpolate_rounds(scene)))
    named = [remedy for remedy in caught.value.remedies if remedy.key]
    assert named
    for remedy in named:
        changed = demo_climb(**{**changes, remedy.key: float(remedy.yaml)})
        plan_forces(changed, plan_instants(changed, interpolate_rounds(changed)))
        assert str(caught.value).count(str(remedy)) >= 1


def test_a_remedy_that_is_off_by_a_digit_is_moved_outwards(demo_climb: SceneMaker) -> None:
    scene = demo_climb(**{"terrain.friction": 0.5})
    instants = plan_instants(scene, interpolate_rounds(scene))
    with pytest.raises(Unresolved) as caught:
        plan_forces(scene, instants)
    (enough,) = (r for r in caught.value.remedies if r.key == "terrain.friction")
    assert isinstance(enough.value, float)
    inward = round(enough.value - 1e-3, 4)
    words = enough.words.replace(f"{enough.value:.4g}", f"{inward:.4g}")
    (moved,) = keep_verified_remedies(
        scene, instants, (replace(enough, words=words, value=inward),)
    )
    assert isinstance(moved.value, float)
    assert moved.value == pytest.approx(enough.value)
    assert f"{moved.value:.4g}" in moved.words
    hopeless = Remedy("mu >= 0.1", "terrain.friction", 0.1)
    amount = Remedy("torque limits 2 times as high")
    assert keep_verified_remedies(scene, instants, (hopeless, amount)) == (amount,)


def test_an_option_has_all_digits_of_its_value() -> None:
    value = float(np.nextafter(0.6125, 1.0)) + 1e-8
    assert float(Remedy("mu", "terrain.friction", value).yaml) == pytest.approx(value, rel=1e-10)
